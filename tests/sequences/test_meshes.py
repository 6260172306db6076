"""What scenes are made of: shapes that face outwards, seamless textures, leaves, the figure, baked light."""

import numpy as np
import pytest
from numpy.typing import NDArray

from sequences import foliage, meshes, props, sculpture, shapes
from sequences.architecture import facade
from sequences.lighting import LightMaps, Weather, illuminate, sky_directions, sky_visibility
from sequences.meshes import Mesh
from sequences.openings import Opening, Style, wall
from sequences.patterns import SIZE, spectral_noise
from sequences.textures import MATERIALS, NUMBER, build

Floats = NDArray[np.float64]


def face_normals(mesh: Mesh) -> Floats:
    p, q, r = (mesh.points[mesh.triangles[:, i]] for i in range(3))
    return np.cross(q - p, r - p)


SOLIDS = {
    "box": shapes.box((0, 0, 0), (1, 2, 3), 2),
    "small box": shapes.box((0, 0, 0), (0.1, 0.2, 0.3), 2),
    "slab": shapes.slab((0, 0, 0), (1, 0, 0), (0, 2, 0.5), (0, 0, 0.3), 2),
    "lathe": shapes.lathe([(0.5, 0), (0.5, 1), (0.01, 1.2)], (0, 0, 0), 2),
    "tube": shapes.tube([(0, 0, 0), (0, 0, 1), (0.2, 0, 2)], [0.1, 0.1, 0.05], 2),
    "moulding": shapes.square_moulding([(0, 1), (0.2, 0.9), (0.2, 0)], 0.5, 2),
    "figure": sculpture.figure(0.05),
}


@pytest.mark.parametrize("name", list(SOLIDS))
def test_solids_face_outwards(name: str) -> None:
    """Triangles wind like their vertex normals, which are unit vectors that point away from the middle."""
    solid = SOLIDS[name]
    np.testing.assert_allclose(np.linalg.norm(solid.normals, axis=1), 1.0, atol=1e-9)
    faces = face_normals(solid)
    real = np.linalg.norm(faces, axis=1) > 1e-9
    agree = np.einsum("ij,ij->i", faces, solid.normals[solid.triangles[:, 0]])
    assert np.mean(agree[real] > 0) > 0.97
    middle = (solid.points.min(axis=0) + solid.points.max(axis=0)) / 2
    outwards = np.einsum("ij,ij->i", solid.points - middle, solid.normals)
    assert np.mean(outwards > 0) > 0.75


def test_extrusion_faces_the_right_of_its_line() -> None:
    """A profile listed from the top faces outwards, to the right of the direction of travel."""
    strip = shapes.extrude([(0.1, 1.0), (0.1, 0.0)], (0, 0, 0), (2, 0, 0), 2)
    np.testing.assert_allclose(
        strip.normals, np.broadcast_to([0.0, -1.0, 0.0], strip.normals.shape), atol=1e-12
    )
    np.testing.assert_allclose(strip.points[:, 1], -0.1)


def test_merged_and_moved_meshes_keep_their_triangles() -> None:
    """Merging shifts vertex numbers; moving, turning and tinting change what they say and nothing else."""
    a, b = SOLIDS["box"], SOLIDS["tube"].moved((5, 0, 0)).turned(90.0).tinted((0.5, 1, 1))
    both = meshes.merge([a, b])
    np.testing.assert_allclose(both.points[both.triangles[len(a.triangles)]], b.points[b.triangles[0]])
    np.testing.assert_allclose(b.points[:, 1].mean(), 5.0, atol=0.2)
    assert both.tint[-1, 0] == 0.5


def test_wall_has_the_area_that_its_openings_leave() -> None:
    """Holes, also side by side at different heights, are cut out and nothing else."""
    openings = [Opening(1.0, 1.0, 1.0, 1.5), Opening(3.0, 0.5, 0.8, 2.2), Opening(4.5, 0.0, 1.0, 2.0)]
    mesh = wall(6.0, 0.0, 4.0, openings, "brick", (1, 1, 1))
    area = 0.5 * np.linalg.norm(face_normals(mesh), axis=1).sum()
    assert area == pytest.approx(24.0 - 1.5 - 1.76 - 2.0)


@pytest.mark.parametrize("ground", ["shop", "door", "plain"])
def test_facades_stand_on_the_ground_and_are_finite(ground: str) -> None:
    """Every kind of ground floor builds; all numbers are finite and all textures exist."""
    mesh = facade(np.random.default_rng(1), 7.0, 3, Style("plaster", (1, 1, 1), ground=ground, shutters=True))
    assert np.isfinite(mesh.points).all()
    assert mesh.points[:, 2].min() >= -1e-9
    assert mesh.triangles.max() < len(mesh.points)
    assert mesh.materials.max() < len(MATERIALS)


def test_props_stand_on_the_ground() -> None:
    """Cars, lamps, signs and the rest touch the ground and reach not below it."""
    things = [props.car((0.5, 0, 0)), props.lamp((0, 0, 0), 1.0), props.bollard((0, 0, 0))]
    things += [props.sign((0, 0, 0), (1, 0, 0)), props.column((0, 0, 0), 4.0, 0.3), props.bench((0, 0, 0))]
    for thing in things:
        assert -0.05 < thing.points[:, 2].min() < 0.05


def test_plants_have_as_many_leaves_as_asked_for_and_stay_in_reach() -> None:
    """A clump fills its ellipsoid; a tree is as high as it should be."""
    rng = np.random.default_rng(2)
    clump = foliage.clump(rng, (1, 2, 3), (0.5, 0.5, 0.3), 200, 0.08)
    assert len(clump.triangles) == 400
    assert np.abs(clump.points - (1, 2, 3)).max() < 0.9
    tree = foliage.tree(rng, (0, 0, 0), 7.0, 1.8, 1300)
    assert 6.0 < tree.points[:, 2].max() < 8.5
    assert np.abs(tree.points[:, :2]).max() < 3.5


@pytest.mark.parametrize("name", list(MATERIALS))
def test_textures_are_seamless_and_not_flat(name: str) -> None:
    """The step across the seam is like the steps within, and values are reflectances."""
    image = MATERIALS[name].make(np.random.default_rng([0, NUMBER[name]]))
    assert image.shape == (SIZE, SIZE, 3)
    assert 0.0 <= image.min() <= image.max() <= 1.0
    assert image.std() > 0.005
    if name in ("coffee", "rocket", "glass"):
        return
    for axis in (0, 1):
        seam = np.abs(np.take(image, 0, axis) - np.take(image, -1, axis)).mean()
        steps = np.abs(np.diff(image, axis=axis)).mean(axis=(1 - axis, 2))
        assert seam <= 1.05 * steps.max()


def test_noise_is_normal_and_periodic() -> None:
    """Mean 0, deviation 1, and the band that was asked for."""
    noise = spectral_noise(np.random.default_rng(3), 1.0, 8, 32)
    assert noise.mean() == pytest.approx(0.0, abs=1e-9)
    assert noise.std() == pytest.approx(1.0)
    spectrum = np.abs(np.fft.fft2(noise))
    assert spectrum[0, 1:7].max() < 1e-6 * spectrum.max()


def test_textures_do_not_depend_on_each_other() -> None:
    """A texture has the same texels whichever others are made, and the last level is its mean."""
    alone, among = build(["brick"], 4), build(["brick", "wood", "stone"], 4)
    number, count = NUMBER["brick"], 3 * SIZE * SIZE
    one, other = (t.texels[t.offsets[number, 0] :][:count] for t in (alone, among))
    np.testing.assert_array_equal(one, other)
    last = alone.texels[alone.offsets[number, -1] :][:3] / 255.0
    mean = ((one.reshape(-1, 3) / 255.0) ** 2).mean(axis=0)
    np.testing.assert_allclose(last**2, mean, atol=0.01)


def test_open_ground_sees_the_whole_sky_and_a_corner_half_of_it() -> None:
    """The share of the sky is 1 in the open, and falls beside a high wall."""
    ground = meshes.patch((-6, -6, 0), (12, 0, 0), (0, 12, 0), NUMBER["stone"], cell_m=0.5)
    barrier = shapes.box((-6, 0, 0), (6, 0.3, 6), NUMBER["stone"], cell_m=20.0)
    maps = LightMaps((0, 0, 1), 9.0, 64, 256, 64)
    thin = np.zeros(len(ground.points), dtype=bool)
    np.testing.assert_allclose(sky_visibility(ground, thin, maps), 1.0, atol=0.02)
    both = meshes.merge([ground, barrier])
    seen = sky_visibility(both, np.zeros(len(both.points), dtype=bool), maps)
    at = np.flatnonzero((np.abs(ground.points[:, 0]) < 0.3) & (np.abs(ground.points[:, 1] + 0.5) < 0.1))
    far = np.flatnonzero((np.abs(ground.points[:, 0]) < 0.3) & (ground.points[:, 1] < -5.9))
    assert 0.4 < seen[at].mean() < 0.68
    assert seen[far].mean() > 0.75


def test_shadow_falls_away_from_the_sun() -> None:
    """The shadow map hides from the sun what stands behind an obstacle, and nothing before it."""
    from sequences._kernels import sunlit

    ground = meshes.patch((-6, -6, 0), (12, 0, 0), (0, 12, 0), NUMBER["stone"])
    block = shapes.box((-1, -1, 0), (1, 1, 2), NUMBER["stone"])
    weather = Weather(azimuth_deg=90.0, elevation_deg=45.0)
    _, light = illuminate(
        meshes.merge([ground, block]), build(["stone"], 0), weather, LightMaps((0, 0, 1), 9, 512, 32, 4)
    )
    assert sunlit(light, -2.0, 0.0, 0.02) == pytest.approx(0.0)
    assert sunlit(light, 2.0, 0.0, 0.02) == pytest.approx(1.0)
    assert sunlit(light, -4.0, 0.0, 0.02) == pytest.approx(1.0)
    assert sunlit(light, 500.0, 0.0, 0.0) == 1.0


def test_sky_directions_cover_the_hemisphere() -> None:
    """They are unit vectors above the horizon with the mean of a uniform hemisphere."""
    directions = sky_directions(200)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert directions[:, 2].min() > 0
    np.testing.assert_allclose(directions.mean(axis=0), (0, 0, 0.5), atol=0.02)
