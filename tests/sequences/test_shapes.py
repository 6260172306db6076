"""Shapes that face outwards, parts of scenes on the ground, textures that do not repeat, shadows."""

from dataclasses import replace

import numpy as np
import pytest

from dvc.arrays import Floats
from sequences import scenery, shapes
from sequences._kernels import sunlit
from sequences.rendered_scenes import illuminate
from sequences.scene_layouts import STREET
from sequences.shapes import Look, Mesh

STONE = Look("stone", (0.5, 0.5, 0.5))
RNG = np.random.default_rng(1)


def face_normals(mesh: Mesh) -> Floats:
    p, q, r = (mesh.points[mesh.triangles[:, i]] for i in range(3))
    return np.cross(q - p, r - p)


SOLIDS = {
    "box": shapes.box((0, 0, 0), (1, 2, 3), STONE),
    "inset box": shapes.box((0, 0, 0), (1, 2, 3), STONE, (0.2, 0.4)),
    "slab": shapes.slab((0, 0, 0), (1, 0, 0), (0, 2, 0.5), (0, 0, 0.3), STONE),
    "lathe": shapes.lathe([(0.5, 0), (0.5, 1), (0.01, 1.2)], (0, 0, 0), STONE),
    "bar": shapes.bar([(0, 0, 0), (0, 0, 1), (0.2, 0, 2)], [0.1, 0.1, 0.05], STONE),
    "ellipsoid": shapes.ellipsoid((1, 2, 3), (1, 2, 0.5), STONE),
    "bumpy ellipsoid": shapes.ellipsoid((0, 0, 0), (1, 1, 1), STONE, RNG),
    "figure": scenery.figure(),
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


def test_boxes_have_the_area_of_their_sides() -> None:
    plain, inset = (
        0.5 * np.linalg.norm(face_normals(SOLIDS[name]), axis=1).sum() for name in ("box", "inset box")
    )
    assert plain == pytest.approx(2 * (2 + 3 + 6))
    assert inset < plain
    top = SOLIDS["inset box"].points[SOLIDS["inset box"].points[:, 2] == 3.0]
    np.testing.assert_allclose(np.ptp(top, axis=0), (0.6, 1.2, 0.0), atol=1e-12)


def test_texture_coordinates_are_metres() -> None:
    """Lengths on a patch are those of its texture, and copies elsewhere have another part of it."""
    patch = shapes.patch((1, 2, 3), (0, 2, 0), (0.5, 0, 3), STONE)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        apart = [np.linalg.norm(values[a] - values[b]) for values in (patch.points, patch.uv)]
        assert apart[0] == pytest.approx(apart[1])
    assert np.abs(patch.moved((0.3, 0.2, 0.1)).uv - patch.uv).min() > 0.1


def test_merged_and_moved_meshes_keep_their_triangles() -> None:
    a, b = SOLIDS["box"], SOLIDS["bar"].moved((5, 0, 0)).turned(90.0)
    both = shapes.merge([a, b])
    np.testing.assert_allclose(both.points[both.triangles[len(a.triangles)]], b.points[b.triangles[0]])
    np.testing.assert_allclose(b.points[:, 1].mean(), 5.0, atol=0.2)
    assert len(both.triangles) == len(both.materials) == len(both.tints)


@pytest.mark.parametrize("ground", ["shop", "door", "plain"])
def test_houses_are_finite_and_on_the_ground(ground: str) -> None:
    style = scenery.Style(Look("plaster", (0.5, 0.5, 0.5)), ground=ground, shutters=True)
    mesh = scenery.house(RNG, 7.0, 3, style)
    assert np.isfinite(mesh.points).all()
    assert mesh.points[:, 2].min() >= -1e-9
    assert mesh.triangles.max() < len(mesh.points)


def test_objects_are_on_the_ground() -> None:
    """Cars, lamps and the rest touch the ground and do not reach below it; a tree has its height."""
    objects = [scenery.car((0.5, 0, 0)), scenery.lamp((0, 0, 0), 1.0), scenery.bollard((0, 0, 0))]
    objects += [scenery.column((0, 0, 0), 4.0, 0.3), scenery.tree(RNG, (0, 0, 0), 7.0, 1.8), scenery.figure()]
    for thing in objects:
        assert -0.05 < thing.points[:, 2].min() < 0.05
    assert 6.0 < objects[-2].points[:, 2].max() < 8.5


def test_shadow_falls_away_from_the_sun() -> None:
    """The shadow map hides points behind an obstacle from the sun, and none before it or outside the map."""
    ground = shapes.patch((-6, -6, 0), (12, 0, 0), (0, 12, 0), STONE)
    block = shapes.box((-1, -1, 0), (1, 1, 2), STONE)
    described = replace(STREET, sun_deg=(90.0, 45.0), shadows=((0, 0, 1), 9.0), shadow_size=512)
    light = illuminate(shapes.merge([ground, block]), described)
    expected = {(-2.0, 0.0, 0.03): 0.0, (2.0, 0.0, 0.03): 1.0, (-4.0, 0.0, 0.03): 1.0, (500.0, 0.0, 0.0): 1.0}
    for point, share in expected.items():
        assert sunlit(light, *point) == pytest.approx(share)
