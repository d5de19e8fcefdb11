# SPDX-License-Identifier: Apache-2.0
"""Walls and outlines from files: our own tables, the header of a DESI state, real planes."""

import numpy as np
import pytest

from fiber_core.convex_parts import convex_hull
from fiber_core.presets.desi import keepouts
from fiber_core.presets.desi_petals import petal_walls
from fiber_core.walls import distances_to_walls
from fiber_formats import FormatError, read_layout, read_obstacles

ROBOTS = "id,x_mm,y_mm\n3,0,0\n4,10.4,0\n"
WALLS = "wall,x_mm,y_mm\n7,20,-5\n7,20,5\n9,0,8\n9,2,8\n9,2,9\n9,1,9\n9,1,12\n9,0,12\n"


def layout(tmp_path, walls=None, robots=ROBOTS, more=()):
    (tmp_path / "own.csv").write_text(robots)
    files = [tmp_path / "own.csv"]
    if walls is not None:
        (tmp_path / "walls.csv").write_text(walls)
        files.append(tmp_path / "walls.csv")
    return read_layout([*files, *more], "desi")


def test_walls_of_a_table_are_walls_of_the_plane(tmp_path):
    found = layout(tmp_path, WALLS)
    walls = found.plane.walls
    assert walls[0].tolist()[:2] == [[20, -5], [20, 5]]
    assert len(walls) > 2 and "1 walls are not convex" in found.notices[-1]
    inside, outside = np.array([[0.5, 11.0], [1.5, 8.5]]), np.array([[1.5, 10.0], [2.1, 8.5]])
    for points, near in ((inside, True), (outside, False)):
        for point in points:
            each = np.tile(point, (len(walls), 1))
            assert (distances_to_walls(each, walls).min() == 0.0) == near, point
    assert ", 3 walls;" in found.summary or ", 4 walls;" in found.summary


@pytest.mark.parametrize(
    "walls, words",
    [
        ("wall,x_mm,y_mm\n1,0,\n", "column y_mm is not a number"),
        ("wall,x_mm,y_mm\nnorth,0,0\n", "column wall is not a whole number"),
        ("wall,x_mm,y_mm\n1,0,0\n1,4,0\n1,1,3\n1,1,-3\n1,4,3\n", "wall 1: a polygon crosses"),
        ("wall,x,y\n1,0,0\n", "no column"),
    ],
)
def test_bad_walls_are_refused(tmp_path, walls, words):
    with pytest.raises(FormatError, match=words):
        layout(tmp_path, walls)


def test_one_file_of_each_kind_stands_beside_a_layout(tmp_path):
    (tmp_path / "discs.csv").write_text("x_mm,y_mm,radius_mm\n0,20,1\n")
    (tmp_path / "more.csv").write_text(WALLS)
    plane = layout(tmp_path, WALLS, more=[tmp_path / "discs.csv"]).plane
    assert plane.obstacles.tolist() == [[0, 20, 1]] and len(plane.walls) > 2
    with pytest.raises(FormatError, match=r"one file of obstacles and one of walls: .*more\.csv"):
        layout(tmp_path, WALLS, more=[tmp_path / "more.csv"])


def test_a_second_layout_is_not_taken_for_obstacles(tmp_path):
    # a plane in two files: robots of the second would become discs that do not move
    more = "id,x_mm,y_mm,arm_theta_mm,arm_phi_mm,radius_mm\n9,30,0,3,3,1.5\n"
    (tmp_path / "more.csv").write_text(more)
    words = "it is a layout and no table of obstacles: it has arm_theta_mm, arm_phi_mm"
    with pytest.raises(FormatError, match=words):
        layout(tmp_path, more=[tmp_path / "more.csv"])
    with pytest.raises(FormatError, match=words):
        read_obstacles(tmp_path / "more.csv")


@pytest.mark.parametrize("scale, said", [(1, 0), (1000, 1)])
def test_walls_and_obstacles_in_other_units_are_named(tmp_path, scale, said):
    # they would keep no robot away
    walls = f"wall,x_mm,y_mm\n1,0,{20 * scale}\n1,{30 * scale},{20 * scale}\n"
    (tmp_path / "discs.csv").write_text(f"x_mm,y_mm,radius_mm\n0,{-20 * scale},{scale}\n")
    robots = "id,x_mm,y_mm\n" + "".join(f"{k},{10.4 * k},0\n" for k in range(12))
    notices = layout(tmp_path, walls, robots, [tmp_path / "discs.csv"]).notices
    for name in ("walls", "obstacles"):
        assert (f"all 1 {name} are far from all robots" in "\n".join(notices)) == bool(said)


def test_each_robot_has_the_outlines_of_its_row(tmp_path):
    robots = "id,x_mm,y_mm,phi_outline_mm\n3,0,0,4 0 -1 1 -1 -1\n4,10.4,0,5 0 4 1 -1 1 -1 -1 4 -1\n"
    found = layout(tmp_path, robots=robots)
    assert found.plane.phi_vertices.shape == (2, 5, 2)
    assert found.plane.phi_vertices[0].tolist() == [[4, 0], [-1, 1]] + 3 * [[-1, -1]]
    assert not found.plane.phi_radius.any()
    assert "outline of theta bodies" in found.summary
    for bad in ("4 0 -1", "4 zero -1 1", "1_0 0 1 1", "nan 0 1 1", ""):
        with pytest.raises(FormatError, match="column phi_outline_mm"):
            layout(tmp_path, robots=robots.replace("4 0 -1 1 -1 -1", bad))
    with pytest.raises(FormatError, match="radius_mm and outlines"):
        layout(tmp_path, robots="id,x_mm,y_mm,radius_mm,phi_outline_mm\n3,0,0,1,0 0 4 0\n")


def in_pixels(x, y):
    return 3000 + 7 * x + 1e-3 * x * y, 3000 - 7 * y + 2e-3 * x * x


def in_header(polygons, to_file=lambda x, y: (x, y)):
    text = ""
    for points in polygons:
        x, y = to_file(*np.array(points, dtype=float).T)
        text += f"#     - - {x.tolist()}\n#       - {y.tolist()}\n"
    return text


def state(tmp_path, rows=90, corner=300.0, pixels=True, unseen=0):
    """Write a state whose header has polygons, all petals alike, with robots of petal 3."""
    x, y = np.random.default_rng(2).uniform(20, 250, (2, rows)).round(4)
    ring = [(0, 0), (corner, 0), (corner, 1), (corner, 2), (corner, 3), (corner, 290), (9, 290)]
    ring += [(0, 280), (0, 999), (999, 999), (999, -5), (0, -5), (0, 0)]
    if not pixels:
        ring = [(min(u, 600), min(v, 600)) for u, v in ring]
    camera = [(305, 0), (310, 0), (310, 5), (305, 5), (305, 0)]
    outlines = [[(tip, 0), (-1, 1), (-1, -1), (tip, 0)] for tip in (4, 5)]
    to_file = in_pixels if pixels else lambda x, y: (x, y)
    numbers = "X_FP Y_FP X_FVC Y_FVC LENGTH_R1 LENGTH_R2 OFFSET_T OFFSET_P PHYSICAL_RANGE_T "
    numbers += "PHYSICAL_RANGE_P POS_T POS_P KEEPOUT_T KEEPOUT_P PETAL_LOC BUS_ID LOCATION"
    words = "DEVICE_TYPE DEVICE_CLASSIFIED_NONFUNCTIONAL"
    text = "# %ECSV 1.0\n# ---\n# datatype:\n"
    text += "".join(f"# - {{name: {name}, datatype: float64}}\n" for name in numbers.split())
    text += "".join(f"# - {{name: {name}, datatype: string}}\n" for name in words.split())
    text += "# meta:\n#   end: 1\n#   keepout:\n"
    text += f"#     gfa:\n{in_header(10 * [camera], to_file)}#     phi:\n{in_header(outlines)}"
    text += f"#     ptl:\n{in_header(10 * [ring], to_file)}#     theta:\n{in_header(outlines)}"
    text += f"#   night: 1\n# schema: astropy-2.0\n{numbers} {words}\n"
    u, v = to_file(x, y)
    u[:unseen] = v[:unseen] = np.nan
    for k in range(rows):
        text += f"{x[k]} {y[k]} {float(u[k])!r} {float(v[k])!r} "
        text += f"3 3 0 0 390 190 0 90 0 {k % 2} 3 1 {3000 + k} POS False\n"
    (tmp_path / "state.ecsv").write_text(text)
    return read_layout(tmp_path / "state.ecsv")


@pytest.mark.parametrize("pixels", [True, False])
def test_the_header_of_a_state_has_edges_cameras_and_outlines(tmp_path, pixels):
    found = state(tmp_path, pixels=pixels)
    plane = found.plane
    assert len(plane.walls) == 8 + 1 and not any("published" in line for line in found.notices)
    assert np.allclose(plane.walls[0][:2], [[0, 0], [300, 0]], atol=1e-3)
    camera = np.unique(np.round(plane.walls[8], 2), axis=0)
    assert np.allclose(camera, [[305, 0], [305, 5], [310, 0], [310, 5]], atol=0.02)
    assert sorted(plane.phi_vertices[0].max(axis=0)) == [1, 4]
    assert sorted(plane.phi_vertices[1].max(axis=0)) == [1, 5]
    assert plane.theta_vertices.max() == 4


def test_robots_that_the_camera_did_not_see_do_not_tell_its_scale(tmp_path):
    found = state(tmp_path, unseen=20)
    assert len(found.plane.walls) == 9 and found.plane.n == 90
    assert np.allclose(found.plane.walls[0][:2], [[0, 0], [300, 0]], atol=1e-3)
    found = state(tmp_path, unseen=80)
    assert "X_FVC, Y_FVC do not tell" in "\n".join(found.notices)


def test_a_state_whose_robots_stand_outside_its_edges_is_refused(tmp_path):
    with pytest.raises(FormatError, match="robots of petal 3 stand outside of its edges"):
        state(tmp_path, corner=200.0)


def test_pixels_that_nothing_explains_are_not_used(tmp_path):
    found = state(tmp_path, rows=20)  # too few to tell the scale
    assert "X_FVC, Y_FVC do not tell" in "\n".join(found.notices)
    assert np.array_equal(found.plane.walls, petal_walls(np.array([3.0])))


def test_the_published_outlines_are_those_of_the_real_state(real_files):
    found = read_layout(real_files / "desi" / "fp-20260219.ecsv")
    plane = found.plane
    assert len(plane.walls) == 120 and "from preset desi_outlines: speeds" in found.summary
    published = petal_walls(np.arange(10.0)).reshape(10, 12, -1, 2)
    shift_mm = plane.walls.reshape(10, 12, -1, 2)[:, :8, :2] - published[:, :8, :2]
    assert np.abs(shift_mm).max() < 0.3  # petals are not quite in their places
    calibration = read_layout(real_files / "desi" / "calib-20260303.csv").plane
    rows = calibration.index_of(plane.ids)
    front = [p.phi_vertices[r, :, 0].max(axis=1) for p, r in ((plane, ...), (calibration, rows))]
    assert np.median(np.abs(front[0] - front[1])) < 1e-3
    larger = calibration.theta_vertices.max(axis=(1, 2)) > plane.theta_vertices.max() + 0.001
    assert larger.sum() <= 295
    body = keepouts(np.array([[3.0, 3.0]]))[0][0]
    assert len(convex_hull(body)) == 13


def test_the_cameras_of_the_real_wok_face_its_centre(real_files):
    files = ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")
    folder = real_files / "sdss_v"
    plane = read_layout([folder / f"apo_{name}.csv" for name in files]).plane
    assert len(plane.walls) == 6 and len(plane.obstacles) == 60
    far = np.hypot(*np.moveaxis(plane.walls, -1, 0))
    assert (far[:, :2] < far[:, 2:]).all()
    assert np.allclose(far[:, :2].min(axis=1), np.hypot(59.54, 273.4), atol=1.0)
