"""Worlds from above: outlines hold what they stand for, and the page is one safe file."""

import json

import numpy as np
import pytest

from companion.messages import FloatArray
from sitl.worlds.plan_view import NAMES, figure, outline, page
from sitl.worlds.primitives import Box, Capsule, Cylinder, Ground, Sphere, World
from sitl.worlds.sites import SITE_NAMES, Site, build_site
from tests.sitl.worlds.oracle import AnyPrimitive

BODIES: list[AnyPrimitive] = [
    Sphere(centre_world_m=(1.0, 2.0, 0.5), radius_m=0.7),
    Cylinder(start_world_m=(3.0, 0.0, 0.0), end_world_m=(3.0, 0.0, 4.0), radius_m=0.3),
    Cylinder(start_world_m=(-3.0, 0.0, 0.0), end_world_m=(-1.0, 1.0, 4.0), radius_m=0.3),
    Capsule(start_world_m=(0.0, -3.0, 1.0), end_world_m=(1.0, -4.0, 1.5), radius_m=0.2),
    Box(centre_world_m=(5.0, 5.0, 1.0), size_m=(2.0, 1.0, 2.0), yaw_deg=30.0),
]


def is_inside(polygon: FloatArray, points: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether points (n, 2) lie in a convex polygon, or less than a centimetre outside."""
    edges = np.diff(polygon, axis=0)
    edges = edges[np.hypot(*edges.T) > 1e-9]
    corners = polygon[:-1][np.hypot(*np.diff(polygon, axis=0).T) > 1e-9]
    turns = (
        np.cross(
            np.pad(edges[:, None, :], ((0, 0), (0, 0), (0, 1))),
            np.pad(points[None, :, :] - corners[:, None, :], ((0, 0), (0, 0), (0, 1))),
        )[..., 2]
        / np.hypot(*edges.T)[:, None]
    )
    return np.asarray(np.all(turns > -0.01, axis=0))


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.shape)
def test_an_outline_holds_the_body_and_little_more(body: AnyPrimitive) -> None:
    world = World.of([body])
    polygon = outline(int(world.kinds[0]), world.rows[0])
    np.testing.assert_allclose(polygon[0], polygon[-1], atol=1e-9)
    points = np.random.default_rng(1).uniform((-7.0, -7.0, -1.0), (8.0, 8.0, 5.0), (200_000, 3))
    solid = points[world.clearance(points) < -0.02]
    assert len(solid) > 5
    assert is_inside(polygon, solid[:, :2]).all()
    low, high = world.bounds_xy()
    assert np.all(polygon.min(axis=0) >= low - 1e-6)
    assert np.all(polygon.max(axis=0) <= high + 1e-6)


@pytest.mark.parametrize("name", SITE_NAMES)
def test_every_site_can_be_drawn(name: str) -> None:
    site = build_site(name, np.random.default_rng(1), followers=4)
    drawn = figure(site)
    json.dumps(drawn, allow_nan=False)
    names = [trace["name"].split(" ")[0] for trace in drawn["data"] if trace.get("fill")]
    expected = {NAMES[int(kind)] for kind in site.world.kinds} - {"ground"}
    assert set(names) == expected
    way = next(trace for trace in drawn["data"] if trace.get("name") == "way")
    assert way["x"][0] == site.spawn_world[0]
    assert way["y"][-1] == pytest.approx(site.waypoints_world[-1][1], abs=1e-3)


def test_the_page_escapes_what_it_shows_and_needs_no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plotly.offline.get_plotlyjs", lambda: "var plotly = '</script>';")
    site = Site("x", World.of([Ground(), *BODIES]), np.zeros(2), np.array([[5.0, 0.0]]))
    text = page(site, "<b>x</b>", "1 & 2")
    assert "&lt;b&gt;x&lt;/b&gt;" in text
    assert "1 &amp; 2" in text
    assert "'<\\/script>'" in text
    assert "default-src 'none'" in text


def test_an_empty_world_can_be_drawn() -> None:
    drawn = figure(Site("empty", World.of([]), np.zeros(2), np.array([[5.0, 0.0]])))
    assert drawn["layout"]["xaxis"]["range"][0] < 0.0
