"""Chapter 2 as it is written: settings of the library, and what its text leaves open."""

from benchmarks.thesis.chapter import Way
from dvc.layers.sprites import SpriteSettings
from dvc.stereo.surfaces.settings import StereoSettings

GEOMETRIC_WEIGHT, GEOMETRIC_LIMIT = 0.1, 3.0
"""lambda_g of (2.13), as a share of tau_2, and tau_1 of (2.16), in labels."""
UNDEFINED_COST = 0.2
"""Of what (2.20) leaves open, as a share of tau_2: somewhat more than what good matches cost."""
ITERATIONS = 5
"""As for figure 2.8; the text tells no others."""

THESIS = StereoSettings(
    cost="squared",
    agreement="exact",
    filling="inferred",
    max_iterations=ITERATIONS,
    min_change=0.0,
    geometric_weight=GEOMETRIC_WEIGHT,
    geometric_limit=GEOMETRIC_LIMIT,
    edge_strength=1.0,
    undefined_cost=UNDEFINED_COST,
    exposures=False,
)
SETTINGS = {Way.THESIS: THESIS, Way.OURS: StereoSettings()}
SPRITES = {Way.THESIS: SpriteSettings(space="depth"), Way.OURS: SpriteSettings()}
READINGS = (
    "S of (2.13) is not given: truncated linear differences of labels on four neighbours, the same "
    "everywhere; "
    "the solver is not given: belief propagation by messages.",
    f"lambda_g, tau_1 and tau_2 are not given: {GEOMETRIC_WEIGHT:g} tau_2, {GEOMETRIC_LIMIT:g} labels, and "
    "a squared difference of 20 levels; one set for all views. Iterations are given for the toy array alone.",
    "(2.15): labels must be equal; a bracket without any neighbour is left out; all cameras are "
    "updated at once.",
    "(2.20) where no neighbour counts: 'by interpolation' is read as a constant, somewhat more than "
    "what good "
    f"matches cost: {UNDEFINED_COST:g} tau_2.",
    "Occupancy in (2.17) is that which (2.15) leaves. Disparities are those that inference gives, without "
    "filling, and visibility is that of the iteration before.",
    "(2.21): cameras vote with all of their voxels; those within a label of what is chosen go with it.",
    "Sprites compare depth, (2.12). The scale of depth of an array without calibration is free: "
    "differences are "
    "counted in steps of a label at the median depth; the limits and likelihoods are not given.",
    "The toy array of the thesis is not public: a rendered one with axes that are not parallel "
    "stands for it.",
)
