"""Chapter 4 as it is written: one map of edges for all rates, and the transforms that it compares."""

from benchmarks.thesis.chapter4.material import Material
from dvc.dibr.depth_image.depth_codes import CodedEdges, code_edges
from dvc.images.edges.chain_code import EdgeCode
from dvc.images.edges.selection import ladder, select
from dvc.images.wavelets.edge_maps import EdgeMaps

EDGES_BPP = 0.015
"""Rate of the edges, in bits per pixel."""
ORDERS = {"SA9/7sym": 0, "SA9/7lin": 1, "SA9/7cub": 3}
"""Order of the extrapolation at edges, by the name of the transform."""
LINEAR = "SA9/7lin"
MOST_EDGES = 4.0
"""How many times as many bits the first selection of edges may have."""
BISECTIONS = 8
"""Between the step of a selection that has more bits, and that of one that has fewer."""
READINGS = (
    "Edges were chosen by hand, from those of Canny's detector: an automatic selection of "
    f"{EDGES_BPP:g} bits per "
    "pixel stands for them, one for all rates, in code words of the thesis.",
    "How the end of a chain is told is not given: each has its length, which counts.",
    "Holes of the map are filled from beside them; all pixels count. The peak of PSNRs is the range "
    "of depth, 53.",
    "Five levels, 9/7 and SPIHT with arithmetic coding as in the thesis, but a coder of this "
    "project, not of QccPack; "
    "rates of maps are those of whole files, header and checksum included.",
    "The picture's rate is that of its coefficients: edges count with the map. As written its "
    "transform always "
    "stops at them; ours leaves them out where they do not help.",
    "Ours selects edges for each rate, by rate and distortion, and codes them in contexts.",
)


def fixed_edges(material: Material) -> CodedEdges:
    """Select the edges of all rates: as many as have their rate in code words."""
    most = EDGES_BPP * material.num_pixels / 8.0
    order = ORDERS[LINEAR]
    finer = None
    for step, edges in ladder(material.depth, 8.0 * MOST_EDGES * most, order):
        chosen = code_edges(edges, EdgeCode.FIXED)
        if len(chosen.data) <= most:
            break
        finer = step, edges
    else:
        return code_edges(EdgeMaps.none((material.depth.shape[0], material.depth.shape[1])))
    if finer is None:
        return chosen
    low, high = finer[0], step
    for _ in range(BISECTIONS):
        middle = (low * high) ** 0.5
        found = code_edges(select(material.depth, finer[1], middle, order), EdgeCode.FIXED)
        if len(found.data) <= most:
            high = middle
            chosen = max(chosen, found, key=lambda coded: len(coded.data))
        else:
            low = middle
    return chosen
