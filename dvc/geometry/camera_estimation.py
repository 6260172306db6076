"""Cameras of plain pictures, two by their matches and more by COLMAP; and cameras of COLMAP models.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

import contextlib
import struct
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from dvc.arrays import Bytes, Floats
from dvc.errors import ConfigError, DvcError
from dvc.geometry.calibrated_cameras import CalibratedViews, Camera, camera_from_matrices
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX, homogeneous

Size = tuple[int, int]

MAX_FEATURES = 8000
MIN_CONTRAST = 0.01
"""Contrast of features, a quarter of the default of OpenCV: walls and floors have points, too."""
RATIO = 0.8
"""Largest ratio of the distances to the nearest and the second nearest descriptor."""
FOCAL_LENGTHS = 0.6, 0.85, 1.2, 1.7, 2.4
"""Initial focal lengths, in units of the longer side of the picture."""
USUAL_FOCAL_LENGTH, FOCAL_SIGMA = 1.0, 0.4
"""Median of focal lengths, and the standard deviation of their natural logarithm."""
NOISE_PX = 0.5
"""Distance of correct matches from their epipolar lines; matches farther away have less weight."""
MAX_ERROR_PX = 1.5
MIN_FOCAL_LENGTH, MAX_FOCAL_LENGTH = 0.6, 3.0
"""Accepted focal lengths, in units of the longer side of the picture."""
SEED = 0
MIN_MATCHES = 30
_MAX_K1 = 0.5
_RECORD_BYTES = {"cameras.bin": 24, "images.bin": 73, "points3D.bin": 51, "rigs.bin": 16, "frames.bin": 72}
"""Smallest record of each binary file of a COLMAP model."""


class Features:
    """SIFT features of a picture."""

    def __init__(self, image: Bytes) -> None:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        detector = cv2.SIFT.create(MAX_FEATURES, contrastThreshold=MIN_CONTRAST)
        keypoints, descriptors = detector.detectAndCompute(grey, None)
        self.points: Floats = np.array([point.pt for point in keypoints], np.float64).reshape(-1, 2)
        self._matches = WeakKeyDictionary[Features, tuple[Floats, Floats]]()  # cached
        self._descriptors = np.zeros((0, 128), np.float32)
        if descriptors is not None:  # RootSIFT: distances are Hellinger's, large gradients count less
            shares = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
            self._descriptors = np.asarray(np.sqrt(shares), np.float32)

    def match(self, other: "Features") -> tuple[Floats, Floats]:
        """Match with another picture."""
        if other not in self._matches:
            forward, backward = self._nearest(other), other._nearest(self)
            pairs = [(a, b) for a, b in forward.items() if backward.get(b) == a]
            index = np.array(pairs, dtype=np.int64).reshape(-1, 2)
            self._matches[other] = self.points[index[:, 0]], other.points[index[:, 1]]
        return self._matches[other]

    def _nearest(self, other: "Features") -> dict[int, int]:
        if min(len(self.points), len(other.points)) < 2:
            return {}
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(self._descriptors, other._descriptors, 2)
        return {
            best.queryIdx: best.trainIdx for best, second in pairs if best.distance < RATIO * second.distance
        }


def estimate_cameras(
    names: Sequence[str], pictures: Sequence[Bytes], features: Sequence[Features] = ()
) -> CalibratedViews:
    """Estimate the cameras of plain pictures from one camera, or one kind of camera."""
    shapes = {picture.shape for picture in pictures}
    if len(shapes) > 1:
        raise ConfigError("cameras can be estimated from pictures of one size only")
    height, width = pictures[0].shape[:2]
    if len(pictures) == 2:
        first, second = features or [Features(picture) for picture in pictures]
        return cameras_of_matches(names, (width, height), *first.match(second))
    with tempfile.TemporaryDirectory() as folder, quiet():
        numbered = [f"{index:06d}.png" for index in range(len(pictures))]
        for name, picture in zip(numbered, pictures, strict=True):
            cv2.imwrite(f"{folder}/{name}", picture[:, :, ::-1])
        model = _mapped(Path(folder), numbered)
        if model is None:
            raise DvcError(
                f"the cameras of these {len(pictures)} views cannot be estimated: too few points match; "
                "give them by --cameras FILE"
            )
        views = _views(model, numbered, [(width, height)] * len(numbered), "the estimate")
    named = [replace(camera, name=name) for name, camera in zip(names, views.cameras, strict=True)]
    return CalibratedViews(tuple(named), views.points)


@dataclass(frozen=True, eq=False)
class _Pose:
    """The second camera, if the first is ``[I | 0]``."""

    R: Floats
    t: Floats  # of length 1
    focal_length: float  # in units of the longer side


def cameras_of_matches(names: Sequence[str], size: Size, first: Floats, second: Floats) -> CalibratedViews:
    """Estimate the cameras of two pictures from their matches."""
    starts = [_consensus(first, second, size, ratio) for ratio in FOCAL_LENGTHS]
    fitted = [_agreed(start, first, second, size) for start in starts if start is not None]
    if not fitted:
        raise DvcError(
            f"the cameras of these two views cannot be estimated: {len(first)} points match, "
            "too few of them consistently; give them by --cameras FILE"
        )
    pose = min(fitted, key=lambda entry: entry[1])[0]
    inliers = np.abs(_sampson_distances(pose, size, first, second)) < MAX_ERROR_PX
    K, views = _intrinsics(size, pose.focal_length), []
    for t in (pose.t, -pose.t):  # epipolar lines leave the sign open; points lie in front of the cameras
        cameras = Camera(names[0], K, np.eye(3), np.zeros(3), size), Camera(names[1], K, pose.R, t, size)
        matches = first[inliers].T, second[inliers].T
        solved = cv2.triangulatePoints(cameras[0].projection, cameras[1].projection, *matches)
        with np.errstate(divide="ignore", invalid="ignore"):
            points = (solved[:3] / solved[3]).T
        depths = [points @ camera.R[2] + camera.t[2] for camera in cameras]
        visible = np.isfinite(points).all(axis=1) & (depths[0] > 0.0) & (depths[1] > 0.0)
        views.append(CalibratedViews(cameras, np.asarray(points[visible], np.float64)))
    return max(views, key=lambda candidate: len(candidate.points))


def _intrinsics(size: Size, ratio: float) -> Floats:
    focal = ratio * max(size)
    return np.array([[focal, 0.0, 0.5 * (size[0] - 1)], [0.0, focal, 0.5 * (size[1] - 1)], [0.0, 0.0, 1.0]])


def _consensus(first: Floats, second: Floats, size: Size, ratio: float) -> _Pose | None:
    """Return the pose with most inliers for a focal length."""
    import pycolmap

    if len(first) < MIN_MATCHES:
        return None
    parameters = [ratio * max(size), 0.5 * size[0], 0.5 * size[1]]
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", params=parameters, width=size[0], height=size[1])
    ransac = pycolmap.RANSACOptions(max_error=MAX_ERROR_PX, random_seed=SEED, num_threads=1)
    answer = pycolmap.estimate_relative_pose(
        camera, first + COLMAP_FIRST_PIXEL_PX, camera, second + COLMAP_FIRST_PIXEL_PX, ransac
    )
    if answer is None or np.count_nonzero(answer["inlier_mask"]) < MIN_MATCHES:
        return None
    pose = np.asarray(answer["cam2_from_cam1"].matrix(), dtype=np.float64)
    return _Pose(pose[:, :3], pose[:, 3] / np.linalg.norm(pose[:, 3]), ratio)


def _agreed(start: _Pose, first: Floats, second: Floats, size: Size) -> tuple[_Pose, float]:
    """Refine a pose and its focal length by all matches; return them and the remaining cost."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    across = np.linalg.svd(start.t[:, None])[0][:, 1:]

    def _moved(x: Floats) -> _Pose:
        t = start.t + across @ x[3:5]
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ start.R
        return _Pose(R, t / np.linalg.norm(t), start.focal_length * float(np.exp(x[5])))

    def _residuals(x: Floats) -> Floats:
        pose = _moved(x)
        distance = _sampson_distances(pose, size, first, second) / NOISE_PX
        unusual = np.log(pose.focal_length / USUAL_FOCAL_LENGTH) / FOCAL_SIGMA
        return np.append(np.sign(distance) * np.sqrt(np.log1p(distance**2)), unusual)

    solved = least_squares(_residuals, np.zeros(6), max_nfev=100)
    return _moved(solved.x), float(solved.cost)


def _sampson_distances(pose: _Pose, size: Size, first: Floats, second: Floats) -> Floats:
    """Return signed distances of matches from their epipolar lines, to first order, in pixels."""
    inverse = np.linalg.inv(_intrinsics(size, pose.focal_length))
    F = inverse.T @ np.cross(np.eye(3), pose.t) @ pose.R @ inverse
    a, b = homogeneous(first), homogeneous(second)
    lines, back = a @ F.T, b @ F
    gradient = (lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return np.asarray((b * lines).sum(axis=1) / np.sqrt(np.maximum(gradient, 1e-300)))


def read_model(folder: Path, names: Sequence[str], sizes: Sequence[Size]) -> CalibratedViews:
    """Read cameras and points of a COLMAP model."""
    import pycolmap

    folders = (folder, folder / "sparse" / "0", folder / "sparse")
    kinds = ("cameras.bin", "cameras.txt")
    source = next((path for path in folders if any((path / kind).is_file() for kind in kinds)), None)
    if source is None:
        raise ConfigError(f"{folder}: has no COLMAP model (cameras.bin or cameras.txt)")
    try:
        _check_counts(source)
        with quiet():
            model = pycolmap.Reconstruction(source)
    except (ValueError, LookupError, RuntimeError, OSError, struct.error) as err:
        raise DvcError(f"{source}: not a COLMAP model that can be read") from err
    return _views(model, names, sizes, str(source))


def _check_counts(source: Path) -> None:
    """Raise an error for binary files with counts beyond their sizes: COLMAP would fill the memory."""
    for name, size in _RECORD_BYTES.items():
        path = source / name
        if not path.is_file():
            continue
        content, position = path.read_bytes(), 8
        (count,) = struct.unpack_from("<Q", content)
        if count * size > len(content):
            raise ValueError(f"{name}: {count} records")
        for _ in range(count if name in ("images.bin", "points3D.bin") else 0):
            if name == "images.bin":
                end = content.index(b"\0", position + 64)  # of the name
                position = end + 9 + 24 * struct.unpack_from("<Q", content, end + 1)[0]
            else:
                position += 51 + 8 * struct.unpack_from("<Q", content, position + 43)[0]
        if position > len(content):
            raise ValueError(f"{name}: truncated")


def _views(model: Any, names: Sequence[str], sizes: Sequence[Size], source: str) -> CalibratedViews:
    try:
        images = {Path(image.name).name: image for image in model.images.values() if image.has_pose}
    except UnicodeDecodeError as err:
        raise DvcError(f"{source}: the name of a picture is not UTF-8 text") from err
    cameras = []
    for name, size in zip(names, sizes, strict=True):
        if name not in images:
            raise ConfigError(f"{source}: has no camera of {name}")
        cameras.append(_camera(model, images[name], name, size))
    numbers = {images[name].image_id for name in names}
    points = [
        point.xyz
        for point in model.points3D.values()
        if sum(element.image_id in numbers for element in point.track.elements) >= 2
    ]
    return CalibratedViews(tuple(cameras), np.array(points, dtype=np.float64).reshape(-1, 3))


def _camera(model: Any, image: Any, name: str, size: Size) -> Camera:
    camera = model.cameras[image.camera_id]
    if (camera.width, camera.height) != size:
        raise ConfigError(f"{name}: {size[0]}x{size[1]}, but its camera is {camera.width}x{camera.height}")
    values = dict(zip(str(camera.params_info).replace(" ", "").split(","), camera.params, strict=True))
    K = np.array(camera.calibration_matrix(), dtype=np.float64)
    K[:2, 2] -= COLMAP_FIRST_PIXEL_PX
    supported = {"f", "fx", "fy", "cx", "cy", "k", "k1", "k2", "p1", "p2"}
    if not values.keys() <= supported:
        raise ConfigError(
            f"{name}: camera model {camera.model_name} is not supported; undistort the pictures"
        )
    k1, k2, p1, p2 = (float(values.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2"))
    pose = np.asarray(image.cam_from_world().matrix(), dtype=np.float64)
    made = camera_from_matrices(name, K, pose[:, :3], pose[:, 3], size)
    return replace(made, distortion=(float(values.get("k", k1)), k2, p1, p2))


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress the log of COLMAP."""
    import pycolmap

    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level


def _mapped(folder: Path, names: Sequence[str]) -> Any | None:
    """Return a model with all pictures; fix the focal length if no model has a free one."""
    import pycolmap

    database = folder / "features.db"
    reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    extraction = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    pycolmap.set_random_seed(SEED)
    pycolmap.extract_features(
        database,
        folder,
        image_names=list(names),
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1)
    pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
    for refined, min_angle_deg in ((True, 2.0), (False, 0.25)):
        options = pycolmap.IncrementalPipelineOptions(
            num_threads=1,
            random_seed=SEED,
            multiple_models=False,
            min_model_size=2,
            ba_refine_focal_length=refined,
            ba_refine_extra_params=refined,
        )
        options.mapper.init_min_num_inliers = MIN_MATCHES
        options.mapper.init_min_tri_angle = min_angle_deg
        options.mapper.filter_min_tri_angle = min(min_angle_deg, options.mapper.filter_min_tri_angle)
        options.triangulation.min_angle = min(min_angle_deg, options.triangulation.min_angle)
        pycolmap.set_random_seed(SEED)
        output = folder / f"refined-{refined}"
        output.mkdir()
        for model in pycolmap.incremental_mapping(database, folder, output, options).values():
            if model.num_reg_images() == len(names):
                lenses = [
                    (c.mean_focal_length() / max(c.width, c.height), c.params[3])
                    for c in model.cameras.values()
                ]
                if all(MIN_FOCAL_LENGTH <= f <= MAX_FOCAL_LENGTH and abs(k) <= _MAX_K1 for f, k in lenses):
                    return model
                break
    return None
