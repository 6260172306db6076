"""Cameras by COLMAP: models that it has written, and cameras estimated from plain pictures.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError, DvcError
from dvc.geometry.calibrated_cameras import CalibratedViews, Camera, camera_from_matrices
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from dvc.geometry.feature_matching import Features
from dvc.geometry.two_views import two_views

Floats = NDArray[np.float64]
Size = tuple[int, int]

MIN_FOCAL_LENGTH, MAX_FOCAL_LENGTH = 0.6, 3.0
"""Of lenses, in units of the longer side of the picture."""
SEED = 0
MIN_MATCHES = 30
_MAX_K1 = 0.5


def read_model(folder: Path, names: Sequence[str], sizes: Sequence[Size]) -> CalibratedViews:
    """Read cameras and points of a COLMAP model."""
    import pycolmap

    places = (folder, folder / "sparse" / "0", folder / "sparse")
    kinds = ("cameras.bin", "cameras.txt")
    place = next((place for place in places if any((place / kind).is_file() for kind in kinds)), None)
    if place is None:
        raise ConfigError(f"{folder}: has no COLMAP model (cameras.bin or cameras.txt)")
    try:
        with quiet():
            model = pycolmap.Reconstruction(place)
    except (ValueError, LookupError, RuntimeError, OSError) as err:
        raise DvcError(f"{place}: not a COLMAP model that can be read") from err
    return _views(model, names, sizes, str(place))


def estimate_cameras(
    names: Sequence[str], pictures: Sequence[NDArray[np.uint8]], features: Sequence[Features] = ()
) -> CalibratedViews:
    """Estimate cameras from plain pictures that one camera, or one kind of camera, has taken."""
    shapes = {picture.shape for picture in pictures}
    if len(shapes) > 1:
        raise ConfigError("cameras can be estimated from pictures of one size only")
    if len(pictures) == 2:
        return two_views(names, pictures, features)
    height, width = pictures[0].shape[:2]
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
    cameras = zip(names, views.cameras, strict=True)
    named = [Camera(name, c.K, c.R, c.t, c.size, c.distortion) for name, c in cameras]
    return CalibratedViews(tuple(named), views.points)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep COLMAP from logging."""
    import pycolmap

    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level


def _views(model: Any, names: Sequence[str], sizes: Sequence[Size], source: str) -> CalibratedViews:
    try:
        images = {Path(image.name).name: image for image in model.images.values() if image.has_pose}
    except UnicodeDecodeError as err:
        raise DvcError(f"{source}: a picture has a name that is no text") from err
    cameras = []
    for name, size in zip(names, sizes, strict=True):
        if name not in images:
            raise ConfigError(f"{source}: has no camera of {name}")
        cameras.append(_camera(model, images[name], name, size))
    wanted = {images[name].image_id for name in names}
    points = [
        point.xyz
        for point in model.points3D.values()
        if sum(element.image_id in wanted for element in point.track.elements) >= 2
    ]
    return CalibratedViews(tuple(cameras), np.array(points, dtype=np.float64).reshape(-1, 3))


def _camera(model: Any, image: Any, name: str, size: Size) -> Camera:
    camera = model.cameras[image.camera_id]
    if (camera.width, camera.height) != size:
        raise ConfigError(f"{name}: {size[0]}x{size[1]}, but its camera is {camera.width}x{camera.height}")
    values = dict(zip(str(camera.params_info).replace(" ", "").split(","), camera.params, strict=True))
    K = np.array(camera.calibration_matrix(), dtype=np.float64)
    K[:2, 2] -= COLMAP_FIRST_PIXEL_PX
    known = {"f", "fx", "fy", "cx", "cy", "k", "k1", "k2", "p1", "p2"}
    if not values.keys() <= known:
        raise ConfigError(
            f"{name}: camera model {camera.model_name} is not supported; undistort the pictures"
        )
    k1, k2, p1, p2 = (float(values.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2"))
    pose = np.asarray(image.cam_from_world().matrix(), dtype=np.float64)
    made = camera_from_matrices(name, K, pose[:, :3], pose[:, 3], size)
    distortion = (float(values.get("k", k1)), k2, p1, p2)
    return Camera(name, made.K, made.R, made.t, size, distortion)


def _mapped(folder: Path, names: Sequence[str]) -> Any | None:
    """Return a model with all pictures; with the usual focal length where a free one leads nowhere."""
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
    for attempt, options in enumerate((_options(True, 2.0), _options(False, 0.25))):
        pycolmap.set_random_seed(SEED)
        found = pycolmap.incremental_mapping(database, folder, _new(folder / str(attempt)), options)
        complete = [model for model in found.values() if model.num_reg_images() == len(names)]
        if complete and _plausible(complete[0]):
            return complete[0]
    return None


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _options(refined: bool, min_angle_deg: float) -> Any:
    """Return options of the mapper: whether intrinsics change, and the least angle between rays."""
    import pycolmap

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
    return options


def _plausible(model: Any) -> bool:
    """Tell whether the intrinsics have stayed where those of lenses are."""
    for camera in model.cameras.values():
        focal = camera.mean_focal_length() / max(camera.width, camera.height)
        if not (MIN_FOCAL_LENGTH <= focal <= MAX_FOCAL_LENGTH and abs(camera.params[3]) <= _MAX_K1):
            return False
    return True
