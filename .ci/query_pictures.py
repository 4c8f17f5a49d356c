# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One small picture a query, for docs/. Each shows what the query really answers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bvh_ros.orientations import quaternions
from bvh_ros.scene import NO_NODE, Scene, SceneHit, ShapeKind, Shapes
from bvh_ros.scene.inspection import outlines
from bvh_ros.scene.shapes.shape import as_shapes

BLUE, ORANGE, GREEN, GREY, LIGHT = '#0072B2', '#D55E00', '#009E73', '#9AA3AD', '#DDE2E7'
WIDTH, HEIGHT = 10.0, 5.0  # m, of the world
TEXT = 8.5
NAMES = 'rack', 'pillar', 'pallet', 'person'
KINDS = [ShapeKind.BOX, ShapeKind.CYLINDER, ShapeKind.BOX, ShapeKind.CYLINDER]
PLACES = [[6.2, 3.8], [4.6, 1.7], [8.0, 1.3], [2.4, 3.6]]
YAWS = quaternions(yaw=[0.2, 0.0, -0.4, 0.0])
SIZES = [[3.0, 0.9, 2.0], [0.9, 0.9, 3.0], [1.4, 0.9, 1.2], [0.8, 0.8, 1.8]]
OBSTACLES = Shapes(KINDS, PLACES, YAWS, SIZES)
STATIC, MOVING = 1, 2  # masks
WALK = [0.0, -1.4]  # m/s, of the person where there is time
FOOTPRINT = [1.1, 0.7]  # m


def world(walks: bool = False) -> Scene:
    """The obstacles of all pictures; if the person `walks`, it has a velocity."""
    scene = Scene(planar=True)
    speeds = [[0.0, 0.0]] * 3 + [WALK] if walks else None
    masks = [STATIC, STATIC, STATIC, MOVING]
    scene.update('map', NAMES, OBSTACLES, stamp=0, velocities=speeds, categories=masks)
    return scene


class Picture:
    """Axes over the world from above, and what is drawn on them."""

    def __init__(self, title: str, found: list[str], dimmed: tuple[str, ...] = ()) -> None:
        from matplotlib.figure import Figure

        self.figure: Any = Figure(figsize=(5.6, 3.1), layout='constrained')
        self.axes: Any = self.figure.subplots()
        self.axes.set(xlim=(0, WIDTH), ylim=(0, HEIGHT), aspect='equal', xticks=[], yticks=[])
        self.axes.set_title(title, fontsize=TEXT + 0.5, family='monospace', loc='left')
        self.axes.spines[:].set_color(GREY)
        for name, outline, place in zip(NAMES, shadows(OBSTACLES), PLACES, strict=True):
            pale = 0.35 if name in dimmed else 1.0
            edge = ORANGE if name in found else GREY
            self.polygon(outline, facecolor=LIGHT, edgecolor=edge, linewidth=1.4, alpha=pale)
            self.say(place, name, ha='center', va='center', alpha=pale, fontsize=TEXT - 1.5)

    def polygon(self, outline: ArrayLike, **style: Any) -> None:
        """A polygon (k, 2)."""
        from matplotlib.patches import Polygon

        self.axes.add_patch(Polygon(np.asarray(outline), **style))

    def robot(self, shapes: Shapes, colour: str = BLUE, **style: Any) -> None:
        """The outlines of shapes."""
        for outline in shadows(shapes):
            self.polygon(outline, fill=False, edgecolor=colour, **{'linewidth': 1.4, **style})

    def line(self, start: ArrayLike, end: ArrayLike, colour: str, **style: Any) -> None:
        """A line between two points."""
        ends = np.array([np.asarray(start)[:2], np.asarray(end)[:2]])
        self.axes.plot(*ends.T, color=colour, **{'linewidth': 1.6, **style})

    def spot(self, place: ArrayLike, colour: str, marker: str = 'o') -> None:
        """A point."""
        x, y = np.asarray(place)[:2]
        self.axes.plot(x, y, marker, color=colour, markersize=5.5)

    def arrow(self, place: ArrayLike, direction: ArrayLike) -> None:
        """A normal of a hit, 0.7 m long."""
        begin = np.asarray(place)[:2]
        end = begin + 0.7 * np.asarray(direction)[:2]
        style = {'arrowstyle': '-|>', 'color': ORANGE, 'lw': 1.2}
        self.axes.annotate('', xy=end, xytext=begin, arrowprops=style)

    def say(self, place: ArrayLike, text: str, **style: Any) -> None:
        """Words."""
        x, y = np.asarray(place)[:2]
        self.axes.text(x, y, text, **{'fontsize': TEXT, **style})

    def save(self, file: Path) -> None:
        """Write an SVG that is the same each time."""
        import matplotlib as mpl

        with mpl.rc_context({'svg.hashsalt': file.stem}):
            self.figure.savefig(file, metadata={'Date': None})


def shadows(shapes: Shapes) -> list[Any]:
    """The outlines (k, 2) of shapes as seen from above."""
    return outlines(as_shapes(shapes, planar=True))


def met(hit: SceneHit | None) -> SceneHit:
    """A hit; without one the picture would show nothing."""
    if hit is None:
        raise RuntimeError('the query of this picture meets nothing')
    return hit


# ---- The pictures, a function each.


def ray() -> Picture:
    """The first obstacle on a segment, and a segment that is free."""
    scene, start, goal = world(), [0.6, 0.9], [9.5, 2.5]
    hit, free = met(scene.raycast(start, goal)), [9.5, 0.4]
    picture = Picture('scene.raycast(start, goal)', [hit.name])
    picture.line(start, hit.point, BLUE)
    picture.line(hit.point, goal, BLUE, linestyle=':', linewidth=1.0)
    picture.arrow(hit.point, hit.normal)
    picture.spot(hit.point, ORANGE)
    picture.say([3.0, 1.75], 'hit.point, hit.normal', ha='center')
    if scene.raycast(start, free) is None:
        picture.line(start, free, GREEN)
        picture.say([5.6, 0.2], 'None: free', color=GREEN)
    picture.spot(start, BLUE)
    picture.say([0.6, 1.05], 'start', ha='center')
    return picture


def swept_ball() -> Picture:
    """A ball that goes along a segment."""
    scene, radius = world(), 0.5
    start, goal = np.array([0.8, 2.6]), np.array([9.2, 2.6])
    hit = met(scene.raycast(start, goal, radius))
    centre = start + hit.t * (goal - start)
    picture = Picture('scene.raycast(start, goal, radius=0.5)', [hit.name])
    for side in (-radius, radius):
        picture.line(np.add(start, [0, side]), np.add(centre, [0, side]), BLUE, linewidth=1.0)
        picture.line(
            np.add(centre, [0, side]), np.add(goal, [0, side]), BLUE, linestyle=':', linewidth=0.8
        )
    picture.robot(Shapes.cylinders([start, centre], radius, 1.0))
    picture.line(start, centre, BLUE, linewidth=1.0)
    picture.spot(hit.point, ORANGE)
    picture.say([0.8, 1.75], 'start', ha='center')
    picture.say(np.add(centre, [-0.1, 0.65]), f't = {hit.t:.2f}', ha='center')
    return picture


def overlap() -> Picture:
    """What touches a footprint at some poses."""
    scene, yaw = world(), quaternions(yaw=[0.0, 0.5, 1.1])
    places = [[1.2, 1.2], [3.3, 2.4], [5.4, 3.0]]
    touches = scene.overlap_many(places, FOOTPRINT, yaw)
    names = {
        hit.name
        for k in range(3)
        for hit in scene.overlap_shape(Shapes.boxes(places[k], FOOTPRINT, yaw[k]))
    }
    picture = Picture('scene.overlap_many(places, [1.1, 0.7], turns)', sorted(names))
    for k in range(3):
        colour = ORANGE if touches[k] else GREEN
        picture.robot(Shapes.boxes(places[k], FOOTPRINT, yaw[k]), colour)
        picture.say(np.add(places[k], [-0.65, -0.75]), str(bool(touches[k])), color=colour)
    return picture


def nearest() -> Picture:
    """The two obstacles that are nearest to a point."""
    point = [3.4, 2.7]
    hits = world().nearest(point, k=2)
    picture = Picture('scene.nearest(point, k=2)', [hit.name for hit in hits])
    for hit in hits:
        picture.line(point, hit.point, BLUE)
        picture.spot(hit.point, ORANGE)
        middle = (hit.point[:2] + point) / 2
        picture.say(np.add(middle, [0.12, 0.1]), f'{hit.t:.2f} m', color=BLUE)
    picture.spot(point, BLUE)
    return picture


def clearance() -> Picture:
    """How far a footprint is from the nearest obstacle."""
    robot = Shapes.boxes([2.2, 1.5], FOOTPRINT, quaternions(yaw=0.6))
    scene = world()
    handles, distances, here, there = scene.clearance_many(robot)
    name = scene.name_of(int(handles[0]))
    picture = Picture('scene.clearance_many(shapes)', [name])
    picture.robot(robot)
    picture.line(here[0], there[0], BLUE)
    picture.spot(here[0], BLUE)
    picture.spot(there[0], ORANGE)
    picture.say((here[0] + there[0]) / 2 + [0.15, -0.1, 0], f'{distances[0]:.2f} m', color=BLUE)
    return picture


def at_a_time() -> Picture:
    """A ball that drives while a person walks across its way."""
    scene, radius, seconds = world(walks=True), 0.35, 6.0
    start, goal = np.array([0.7, 0.8]), np.array([6.7, 0.8])
    hit = met(scene.raycast(start, goal, radius, at=0.0, until=seconds))
    meeting = hit.t * seconds
    picture = Picture('scene.raycast(start, goal, 0.35, at=0.0, until=6.0)', [])
    for then in (*np.arange(0.0, meeting, 1.0), meeting):
        last = then == meeting
        fade = 1.0 if last else 0.3
        ball = start + then / seconds * (goal - start)
        picture.robot(Shapes.cylinders(ball, radius, 1.0), alpha=fade)
        person = np.add(PLACES[3], np.multiply(WALK, then))
        picture.robot(Shapes.cylinders(person, 0.4, 1.8), ORANGE, alpha=fade)
    picture.spot(hit.point, ORANGE)
    if scene.raycast(start, goal, radius) is None:
        picture.say([5.5, 0.1], 'free, if nobody walked', color=GREEN)
    picture.line(start, goal, BLUE, linestyle=':', linewidth=0.8)
    picture.say([2.9, 2.3], f'contact after {meeting:.1f} s')
    return picture


def views() -> Picture:
    """One ray, asked with two masks."""
    scene, start, goal = world(), np.array([0.6, 3.9]), np.array([9.5, 3.3])
    every = met(scene.raycast(start, goal))
    static = met(scene.raycast(start, goal, mask=STATIC))
    picture = Picture('scene.raycast(start, goal, mask=STATIC)', [static.name], (every.name,))
    picture.line(start, static.point, BLUE)
    picture.spot(every.point, GREY)
    picture.spot(static.point, ORANGE)
    picture.say(
        np.add(every.point[:2], [-0.2, -0.95]), 'a view without people\nlooks through them'
    )
    picture.spot(start, BLUE)
    return picture


def turning_sweep() -> Picture:
    """A load that turns on its way: both poses are free, the way is not."""
    scene = world()
    load = Shapes.boxes([2.6, 1.5], [2.4, 0.4], quaternions(yaw=0.2))
    goal, turned = [4.0, 3.3], quaternions(yaw=2.2)
    hit = met(scene.sweep_shape(load, goal, turned))
    picture = Picture('scene.sweep_shape(load, goal, turned)', [hit.name])
    step = np.subtract(goal, load.position[0])
    for share in np.linspace(0.0, 1.0, 9):
        yaws = quaternions(yaw=0.2 + share * 2.0)
        pose = Shapes.boxes(load.position[0] + share * step, [2.4, 0.4], yaws)
        picture.robot(pose, alpha=1.0 if share in (0.0, 1.0) else 0.3)
    picture.spot(hit.point, ORANGE)
    poses = Shapes.boxes([load.position[0], goal], [2.4, 0.4], quaternions(yaw=[0.2, 2.2]))
    if not any(scene.overlap_shape(poses.take([row])) for row in (0, 1)):
        picture.say([6.4, 2.4], f'both poses are free;\ncontact at t = {hit.t:.2f}')
    return picture


def lidar() -> Picture:
    """A scan of 180 beams from one place."""
    scene, origin = world(), np.array([3.4, 0.8])
    angles = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    beams = np.column_stack((np.cos(angles), np.sin(angles)))
    hits = scene.raycast_many(origin, beams, 6.0)
    returned = hits.handles != NO_NODE
    picture = Picture('scene.raycast_many(origin, beams, 6.0)', [])
    for end in (origin + np.minimum(hits.t, 6.0)[:, None] * beams)[returned]:
        picture.line(origin, end, BLUE, linewidth=0.4, alpha=0.6)
    picture.axes.plot(*hits.points[returned, :2].T, 'o', color=ORANGE, markersize=2.5)
    picture.spot(origin, BLUE)
    return picture


PICTURES: tuple[Callable[[], Picture], ...] = (
    ray, swept_ball, overlap, nearest, clearance, at_a_time, views, turning_sweep, lidar,
)  # fmt: skip
