"""Parameters of the whole reconstruction, grouped by step."""

from dataclasses import dataclass, field, replace

from dvc.geometry.cameras import PixelFrame
from sfm.cameras.bundle_adjustment import BundleAdjustmentSettings
from sfm.cameras.self_calibration import SelfCalibrationSettings
from sfm.correspondences.corner_matching import FeatureSettings, MatchingSettings
from sfm.correspondences.densification import DensificationSettings, PropagationSettings
from sfm.correspondences.epipolar_search import SearchSettings
from sfm.estimation.degeneracy import DegeneracySettings
from sfm.estimation.weak_calibration import WeakCalibrationSettings

ALTERNATIONS = 100
"""Number of alternations without joint steps; the thesis does not specify it."""


@dataclass(frozen=True)
class CorrespondenceSettings:
    """Parameters of the correspondences."""

    features: FeatureSettings = field(default_factory=FeatureSettings)
    matching: MatchingSettings = field(default_factory=MatchingSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    densification: DensificationSettings = field(default_factory=DensificationSettings)
    propagation: PropagationSettings = field(default_factory=PropagationSettings)


@dataclass(frozen=True)
class OutlierSettings:
    """Limits of the tests for outliers that are not part of another step."""

    motion_limit_px: float = 2.0  # allowed difference from the neighbours' median motion
    motion_spreads: float = 3.0  # ... and in units of the neighbours' own spread
    max_reprojection_px: float = 1.0  # largest reprojection error
    epipole_distance_px: float = 10.0  # least distance to an epipole; nearer points cannot be triangulated
    depth_share: float = 0.1  # allowed difference of inverse depths, as a share of the median
    depth_spreads: float = 3.0  # ... and in units of the neighbours' own spread


@dataclass(frozen=True)
class CameraSettings:
    """Parameters of the second camera, given the epipolar geometry."""

    self_calibration: SelfCalibrationSettings = field(default_factory=SelfCalibrationSettings)
    bundle_adjustment: BundleAdjustmentSettings = field(default_factory=BundleAdjustmentSettings)
    num_adjustments: int = 3  # number of bundle adjustments, with outliers removed in between


@dataclass(frozen=True)
class TrustSettings:
    """Requirements for a model to be trusted."""

    # number of correspondences from CIF size on; smaller pictures need down to half of it. Chosen on the clip
    # "stone" (QP 32, 17 frames): 50 and 200 took 5 % more Wyner-Ziv bits than 100.
    min_num_points: int = 100
    min_coverage: float = 0.25  # share of the cells of an 8x8 grid that must hold a correspondence
    min_inlier_share: float = 0.4  # share of the matched corners that agree with the epipolar geometry

    def num_points_needed(self, frame: PixelFrame) -> int:
        """Return the number of correspondences that a frame needs."""
        share = frame.width_px * frame.height_px / (352 * 288)
        return round(self.min_num_points * min(max(share, 0.5), 1.0))


@dataclass(frozen=True)
class SfmSettings:
    """Parameters of `sfm.pipeline.reconstruct`; thresholds on images are in pixels."""

    correspondences: CorrespondenceSettings = field(default_factory=CorrespondenceSettings)
    weak_calibration: WeakCalibrationSettings = field(default_factory=WeakCalibrationSettings)
    degeneracy: DegeneracySettings = field(default_factory=DegeneracySettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    cameras: CameraSettings = field(default_factory=CameraSettings)
    trust: TrustSettings = field(default_factory=TrustSettings)
    colmap_max_error_px: float = 1.0  # largest error of an inlier in COLMAP's estimators

    def as_written(self) -> "SfmSettings":
        """Return these settings with cameras exactly as in section 5.2 of the thesis."""
        linear_program = SelfCalibrationSettings(
            first_depth_ratio=None, dropped_share=0.0, max_dropped_share=0.0, free_unit=False
        )
        alternation = BundleAdjustmentSettings(num_alternations=ALTERNATIONS, max_iterations=0)
        cameras = replace(self.cameras, self_calibration=linear_program, bundle_adjustment=alternation)
        return replace(self, cameras=cameras)
