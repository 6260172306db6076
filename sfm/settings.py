"""Parameters of the whole reconstruction, grouped by step."""

from dataclasses import dataclass, field

from sfm.cameras.bundle_adjustment import BundleAdjustmentOptions
from sfm.cameras.self_calibration import SelfCalibrationOptions
from sfm.correspondences.densification import DensificationSettings
from sfm.correspondences.features import FeatureSettings
from sfm.correspondences.matching import MatchingSettings
from sfm.correspondences.propagation import PropagationSettings
from sfm.estimation.degeneracy import DegeneracyOptions
from sfm.estimation.weak_calibration import WeakCalibrationOptions


@dataclass(frozen=True)
class SfmSettings:
    """Parameters of `sfm.pipeline.reconstruct`; thresholds on images are in pixels."""

    features: FeatureSettings = field(default_factory=FeatureSettings)
    matching: MatchingSettings = field(default_factory=MatchingSettings)
    weak_calibration: WeakCalibrationOptions = field(default_factory=WeakCalibrationOptions)
    degeneracy: DegeneracyOptions = field(default_factory=DegeneracyOptions)
    self_calibration: SelfCalibrationOptions = field(default_factory=SelfCalibrationOptions)
    bundle_adjustment: BundleAdjustmentOptions = field(default_factory=BundleAdjustmentOptions)
    densification: DensificationSettings = field(default_factory=DensificationSettings)
    propagation: PropagationSettings = field(default_factory=PropagationSettings)
    colmap_max_error_px: float = 1.0  # largest error of an inlier for COLMAP's estimators
    num_adjustments: int = 3  # bundle adjustments, outliers being removed between them
    min_num_points: int = 50  # correspondences without which a model is not trusted
    motion_limit_px: float = 2.0  # difference from the neighbours' median motion that is always allowed
    motion_spreads: float = 3.0  # ... and in units of the neighbours' own spread
    max_reprojection_px: float = 1.0  # distance of a projected 3D point from where it was seen
    epipole_distance_px: float = 10.0  # nearer to an epipole nothing can be triangulated
    depth_share: float = 0.1  # difference of inverse depths that is always allowed, of the median one
    depth_spreads: float = 3.0  # ... and in units of the neighbours' own spread
    min_coverage: float = 0.25  # share of the cells of an 8x8 grid that must hold a correspondence
    min_inlier_share: float = 0.4  # of the matched corners, that must agree with the epipolar geometry
