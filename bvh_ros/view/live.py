# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node that runs: its sources are heard and decoded here, questions go to its services."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import BvhClient, BvhTimeoutError
from bvh_ros.ros.access import BvhServer, FrameError, Frames, Transform, nanoseconds
from bvh_ros.ros.cdr import marker_array
from bvh_ros.ros.cdr.marker_array import MarkerTable
from bvh_ros.ros.conversions import outlines, query_clouds, rotations
from bvh_ros.ros.conversions.placing import alike, joined
from bvh_ros.ros.parameters import LASER_SCAN, ScanSettings, scan_settings
from bvh_ros.ros.parts.diagnostics import Maintenance
from bvh_ros.scene import AS_SURFACE, ShapeKind, Shapes, mesh_of
from bvh_ros.view.worlds import (
    NO_POINTS,
    Answer,
    Floats,
    Frame,
    Group,
    Integers,
    Overlay,
    ShownWorld,
    Wanted,
    answer,
)

# ---- The pictures for RViz on `~/scene`, `~/tree` and `~/queries`, read as arrays


NO_BOXES = (NO_POINTS, NO_POINTS, np.empty(0, np.int64))
LISTS = {Marker.CUBE_LIST: ShapeKind.BOX, Marker.SPHERE_LIST: ShapeKind.SPHERE}
SINGLES = {Marker.SPHERE: ShapeKind.SPHERE, Marker.CYLINDER: ShapeKind.CYLINDER}
CORNERS_A_BOX = len(outlines.TRIANGLES)
# Where, among the corners of a box's triangles, each of its eight corners comes first.
FIRST = np.array([int(np.flatnonzero(corner == outlines.TRIANGLES)[0]) for corner in range(8)])


def obstacles(message: bytes) -> dict[str, Shapes]:
    """Return the shapes of each source that `~/scene` shows."""
    table = marker_array.read(message)
    found: dict[str, list[Shapes]] = {}
    for row, kind in enumerate(table.type.tolist()):
        drawn = None
        if kind in LISTS:
            drawn = _of_list(table, row, LISTS[kind])
        elif kind in SINGLES:
            places = table.position[row : row + 1], table.orientation[row : row + 1]
            drawn = alike(SINGLES[kind], *places, table.scale[row : row + 1])
        elif kind == Marker.TRIANGLE_LIST:
            points = table.points(row)
            drawn = _of_boxes(points) if _are_boxes(points) else _of_mesh(points)
        if drawn is not None:
            source = table.namespaces[int(table.namespace[row])]
            found.setdefault(source, []).append(drawn)
    return {source: joined(several) for source, several in found.items()}


def tree(message: bytes, first_depth: int, planar: bool) -> tuple[Floats, Floats, Integers]:
    """Return the boxes (n, 3) that `~/tree` shows, lo and hi, and their depths.

    They come depth by depth, each in another colour than the one before.
    """
    table = marker_array.read(message)
    for row in np.flatnonzero(table.type == Marker.LINE_LIST).tolist():
        ends, colours = table.points(row), table.colours(row)
        each = 8 if planar else 24
        boxes = ends.reshape(-1, each, 3)
        news = np.any(np.diff(colours[::each], axis=0) != 0.0, axis=1)
        depths = first_depth + np.concatenate(([0], np.cumsum(news)))
        return boxes.min(axis=1), boxes.max(axis=1), depths
    return NO_BOXES


def queries(message: bytes) -> Overlay:
    """Return what `~/queries` shows."""
    table, shown = marker_array.read(message), Overlay()
    for row, kind in enumerate(table.type.tolist()):
        if kind == Marker.LINE_LIST:
            lines = table.points(row).reshape(-1, 2, 3)
            shown = shown._replace(lines=lines, colours=table.colours(row)[::2, :3])
        elif kind == Marker.SPHERE_LIST:
            shown = shown._replace(spots=table.points(row))
    return shown


def _of_list(table: MarkerTable, row: int, kind: ShapeKind) -> Shapes:
    turn = rotations.normalised(table.orientation[row])
    places = rotations.rotate(turn, table.points(row)) + table.position[row]
    count = len(places)
    return alike(kind, places, np.tile(turn, (count, 1)), np.tile(table.scale[row], (count, 1)))


def _are_boxes(points: Floats) -> bool:
    """Whether these are the triangles of boxes, as the node writes them, not those of a mesh."""
    if len(points) % CORNERS_A_BOX:
        return False
    corners = points.reshape(-1, CORNERS_A_BOX, 3)
    return np.array_equal(corners, corners[:, FIRST][:, outlines.TRIANGLES])


def _of_mesh(points: Floats) -> Shapes:
    """One surface; where it is too small or too large for one, the box around it."""
    try:
        mesh = mesh_of(points.reshape(-1, 3, 3), AS_SURFACE)
    except ValueError:
        lo, hi = points.min(axis=0), points.max(axis=0)
        return Shapes.boxes([0.5 * lo + 0.5 * hi], hi - lo)
    return Shapes.of_meshes(mesh, np.zeros((1, 3)))


def _of_boxes(points: Floats) -> Shapes:
    """Boxes from twelve triangles each."""
    corners = points.reshape(-1, CORNERS_A_BOX, 3)[:, FIRST]
    axes = corners[:, (1, 2, 4)] - corners[:, :1]  # (n, 3, 3): the edges along x, y and z
    sizes = np.linalg.norm(axes, axis=2)
    middle = 0.5 * (corners[:, 0] + corners[:, 7])
    units = np.where(sizes[..., None] > 0.0, axes / np.maximum(sizes, 5e-324)[..., None], 0.0)
    return alike(ShapeKind.BOX, middle, _quaternions(units), sizes)


def _quaternions(axes: Floats) -> Floats:
    """Unit quaternions (n, 4) of three unit axes (n, 3, 3); an axis may be missing (zero)."""
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    x = np.where((x == 0.0).all(axis=1, keepdims=True), np.cross(y, z), x)
    y = np.where((y == 0.0).all(axis=1, keepdims=True), np.cross(z, x), y)
    z = np.where((z == 0.0).all(axis=1, keepdims=True), np.cross(x, y), z)
    from scipy.spatial.transform import Rotation

    matrices = np.stack((x, y, z), axis=2)
    sound = np.abs(np.linalg.det(matrices)) > 0.5  # else two axes are missing: any turn will do
    matrices[~sound] = np.eye(3)
    quaternions: Floats = Rotation.from_matrix(matrices).as_quat()
    return quaternions


# ---- The topics of a node: diagnostics and pictures


LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
POSES_KEPT = 100
WORLD_FIGURES = {'height': 'height of the tree', 'cost': 'cost', 'expired': 'expired'}
RATES = {
    'updates a second': 'updates a second',
    'answers a second': 'answers a second',
    'p50 [ms]': 'median [ms]',
    'p99 [ms]': 'p99 [ms]',
}


class Topics:
    """Listens to a node's topics; to pictures only while the page shows them.

    Parameters
    ----------
    node : rclpy.node.Node
        Ours.
    name : str
        Of the other node, with its namespace.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self.figures: dict[str, str] = {}
        self.drawn: dict[str, Shapes] = {}  # what `~/scene` shows of each source
        self.scenes = 0  # messages of ~/scene
        self.boxes: tuple[Floats, Floats, Integers] = NO_BOXES
        self.overlay = Overlay()
        self._source_topics: dict[str, str] = {}
        self._wanted: dict[str, Subscription] = {}
        self._poses: dict[int, PoseStamped] = {}
        self._frames = Frames('')
        self._scan: ScanSettings | None = None
        self._pose_subscription: Subscription | None = None
        node.create_subscription(DiagnosticArray, '/diagnostics', self._note, 10)
        self._listen('scene', MarkerArray, self._draw, raw=True)

    def sources(self) -> dict[str, str]:
        """The sources of the node and their topics; empty before its first diagnostics."""
        return self._source_topics

    def place_scans_with(self, frames: Frames, settings: ScanSettings) -> None:
        """Tell where the node's scanner is."""
        self._frames, self._scan = frames, settings

    def want(self, wanted: Wanted) -> None:
        """Listen to these topics, and to no other picture."""
        self._switch('tree', wanted.tree, MarkerArray, self._draw_tree, raw=True)
        self._switch('queries', wanted.queries, MarkerArray, self._draw_queries, raw=True)
        if not wanted.queries:
            self.overlay = Overlay(scan=self.overlay.scan)
        if self._scan is not None and self._scan.pose_topic:
            kind = LaserScan if self._scan.type == LASER_SCAN else PointCloud2
            if wanted.scan and self._pose_subscription is None:
                topic = self._scan.pose_topic.replace('~', self._name, 1)
                self._pose_subscription = self._node.create_subscription(
                    PoseStamped, topic, self._keep_pose, 10
                )
            self._switch('virtual_scan', wanted.scan, kind, self._draw_scan)
            if not wanted.scan:
                self.overlay = self.overlay._replace(scan=NO_POINTS)

    def _switch(
        self, topic: str, on: bool, kind: type, callback: Callable[[Any], None], raw: bool = False
    ) -> None:
        if on and topic not in self._wanted:
            self._listen(topic, kind, callback, raw)
        elif not on and topic in self._wanted:
            self._node.destroy_subscription(self._wanted.pop(topic))

    def _listen(
        self, topic: str, kind: type, callback: Callable[[Any], None], raw: bool = False
    ) -> None:
        qos = 5 if topic == 'virtual_scan' else LATCHED
        self._wanted[topic] = self._node.create_subscription(
            kind, f'{self._name}/{topic}', callback, qos, raw=raw
        )

    def _note(self, message: DiagnosticArray) -> None:
        """Take the figures of our node out of those of all nodes."""
        beginning = f'{self._name.lstrip("/")}: '
        mine = {
            status.name.removeprefix(beginning): {pair.key: pair.value for pair in status.values}
            for status in message.status
            if status.name.startswith(beginning)
        }
        if not mine:
            return
        figures: dict[str, str] = {}
        for part, values in mine.items():
            if part.startswith('source ') and 'topic' in values:
                self._source_topics[part.removeprefix('source ')] = values['topic']
            wanted = WORLD_FIGURES if part == 'world' else RATES
            shown = {new: values[old] for old, new in wanted.items() if old in values}
            where = '' if part == 'world' else f'{part}: '
            figures |= {f'{where}{key}': value for key, value in shown.items()}
        self.figures = figures

    def _draw(self, message: bytes) -> None:
        self.drawn = obstacles(message)
        self.scenes += 1

    def _draw_tree(self, message: bytes) -> None:
        first, planar = (
            self._node.get_parameter(name).value for name in ('draw.first_depth', 'planar')
        )
        self.boxes = tree(message, first, planar)

    def _draw_queries(self, message: bytes) -> None:
        self.overlay = queries(message)._replace(scan=self.overlay.scan)

    def _keep_pose(self, pose: PoseStamped) -> None:
        self._poses[nanoseconds(pose.header.stamp)] = pose
        if len(self._poses) > POSES_KEPT:
            del self._poses[next(iter(self._poses))]

    def _draw_scan(self, scan: Any) -> None:
        if not self._poses:
            return
        stamp = nanoseconds(scan.header.stamp)
        pose = self._poses.get(stamp, self._poses[next(reversed(self._poses))])
        try:
            place = self._place_of(pose)
        except FrameError:
            return  # the node says so itself
        if isinstance(scan, LaserScan):
            points = place.points(_points_of(scan))
        elif scan.header.frame_id == self._frames.frame_id:
            points = query_clouds.read_answers(scan, query_clouds.Hits).points
        else:
            points = place.points(query_clouds.read_answers(scan, query_clouds.Hits).points)
        self.overlay = self.overlay._replace(scan=points[np.isfinite(points).all(axis=1)])

    def _place_of(self, stamped: PoseStamped) -> Transform:
        header, pose = stamped.header, stamped.pose
        place = Transform.of(pose.position, pose.orientation)
        into = self._frames.into_node(header.frame_id, nanoseconds(header.stamp))
        return place if into is None else into.after(place)


def _points_of(scan: LaserScan) -> Floats:
    """Where the beams end, in the scanner's frame."""
    ranges = np.array(scan.ranges, np.float64)
    ranges[~np.isfinite(ranges)] = np.nan
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    return np.stack((ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * ranges), axis=1)


# ---- A running node: its sources are decoded here, queries go to its services


PATIENCE = 30.0  # seconds for parameters and diagnostics
LOOK_EVERY = 1.0
ANSWER_WITHIN = 2.0
NO_HANDLES = np.empty(0, np.int64)


class Live(ShownWorld):
    """A bvh node, as any client sees it.

    The messages of its sources are decoded here, as fast as they come, into a scene of our own.
    Of a source that published before the view started, `~/scene` is shown, once a second. Picks
    and other questions are answered by the node itself. When the node ends, what was there stays;
    when it comes back, the view begins anew, with the parameters that it has then.

    Parameters
    ----------
    name : str
        The node's, with its namespace: `/bvh`.
    waiting : callable
        Called now and then while the node is waited for; may raise to give up.

    Raises
    ------
    BvhTimeoutError
        If the node serves, but tells no parameters or diagnostics.
    """

    def __init__(self, name: str, waiting: Callable[[], object] = lambda: None) -> None:
        self._name, self._waiting = name, waiting
        self._returned = 0  # times
        self._open()

    def _open(self) -> None:
        """Wait for the node, and listen as it does."""
        name, space = self._name, self._name.rpartition('/')[0] or '/'
        node = rclpy.create_node('bvh_view_start', namespace=space)
        try:
            _retry(partial(BvhClient(node, name).wait_until_ready, 0.5), self._waiting)
            parameters = _parameters(node, name)
            heard = Topics(node, name)
            _until(node, heard.sources, name, 'diagnostics')
        finally:
            node.destroy_node()
        # `~` and remappings mean something else to us.
        topics = {f'{source}.topic': topic for source, topic in heard.sources().items()}
        parameters = [
            Parameter(one.name, value=topics.get(one.name, one.value)) for one in parameters
        ]
        self.node = Node('bvh_view', namespace=space, parameter_overrides=parameters)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.topics = Topics(self.node, name)
        self._server = BvhServer(self.node)
        world = self._server.world
        super().__init__(name, world.scene)
        self.frame_id = world.frames.frame_id
        self.has_queries = True
        scan = scan_settings(self._server.settings.groups['virtual_scan'])
        self.has_scan = bool(scan.pose_topic)
        self.topics.place_scans_with(world.frames, scan)
        self._client = BvhClient(self.node, name, timeout=ANSWER_WITHIN)
        self._sources = {source.name: source for source in world.sources}
        for source in world.sources:
            source.subscribe()
        self._maintenance = Maintenance(self.node, world)
        self._known: set[bytes] = set()  # the node's publishers at first
        self._present: set[bytes] = set()  # and now
        self._looked_at = 0.0

    def prepare(self) -> None:
        """Nothing: the node has compiled what it needs."""

    def advance(self, until: float) -> None:
        """Hear what comes until then; begin anew with a node that came back."""
        if time.monotonic() - self._looked_at > LOOK_EVERY:
            self._look()
        self._executor.spin_once(0.0)
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(left)

    def _look(self) -> None:
        """Whether the node is there, and still the one that we have listened to."""
        self._looked_at = time.monotonic()
        others = self.node.get_publishers_info_by_topic(f'{self._name}/scene')
        found = {bytes(one.endpoint_gid) for one in others}
        was_there, self._present = self._known, found
        self._known = self._known or found
        if found and was_there and not found & was_there:
            self.close()
            self._returned += 1
            _retry(self._open, self._waiting)  # it may end once more

    def want(self, wanted: Wanted) -> None:
        """Subscribe to what the page shows."""
        self.topics.want(wanted)

    def version(self) -> Hashable:
        """Another one after each message."""
        heard = sum(source.messages for source in self._sources.values())
        return self._returned, heard, self.scene.population, self.topics.scenes

    def groups(self) -> list[Group]:
        """All obstacles by source: as heard here or, where that is not all, from `~/scene`."""
        heard = {group.source: group for group in super().groups()}
        drawn = self.topics.drawn
        for source, shapes in drawn.items():
            mine = len(heard[source].handles) if source in heard else 0
            if mine < len(shapes.kind) and not self._knows_all(source):
                heard[source] = Group(source, shapes, NO_HANDLES)
        return [*heard.values()]

    def _knows_all(self, name: str) -> bool:
        source = self._sources.get(name)
        return source is not None and source.has_spoken and not source.completeness.missing()

    def levels(self, first: int, last: int) -> tuple[Floats, Floats, Integers]:
        """Boxes of the node's tree, as it tells them on `~/tree`."""
        lo, hi, depths = self.topics.boxes
        shown = (depths >= first) & (depths <= last)
        return lo[shown], hi[shown], depths[shown]

    @property
    def height(self) -> int:
        """The greatest depth that the node tells of."""
        return int(self._server.settings.groups['draw']['last_depth'])

    def overlay(self) -> Overlay:
        """The last queries and hits, and the virtual scan."""
        return self.topics.overlay

    def frames(self) -> list[Frame]:
        """The frames of the parameter `transforms`."""
        frames = self._server.world.frames
        given = [settings.frame_id for settings in self._server.settings.transforms]
        places = {name: frames.into_node(name) for name in given}
        return [
            Frame(name, place.translation, place.rotation)
            for name, place in places.items()
            if place is not None
        ]

    def now(self) -> int:
        """The node's clock."""
        return int(self.node.get_clock().now().nanoseconds)

    def figures(self) -> dict[str, str]:
        """What the node's diagnostics tell."""
        if self._has_ended:
            return {'the node': 'has ended; this is what was there'}
        return self.topics.figures

    def raycast(self, start: Floats, goal: Floats) -> Answer:
        """Ask the node for the first obstacle on a segment; the time is that of the round trip."""
        began = self._begin()
        hit = self._client.raycast(start.tolist(), goal.tolist())
        return answer([] if hit is None else [hit], began)

    def overlap(self, lo: Floats, hi: Floats) -> Answer:
        """Ask the node for all obstacles that touch a box."""
        began = self._begin()
        return answer(self._client.overlap(lo.tolist(), hi.tolist()), began)

    def _begin(self) -> float:
        """When a query begins; RuntimeError if the node has ended."""
        if self._has_ended:
            raise RuntimeError(f'{self._name} has ended')
        return time.perf_counter()

    @property
    def _has_ended(self) -> bool:
        return bool(self._known) and not self._present

    def close(self) -> None:
        """Destroy the node."""
        self._maintenance.destroy()
        self._server.destroy()
        for source in self._sources.values():
            source.destroy()
        self._executor.shutdown()
        self.node.destroy_node()


def _retry(act: Callable[[], object], waiting: Callable[[], object]) -> None:
    """Do it until the node is there in time."""
    while True:
        try:
            act()
            return
        except BvhTimeoutError:
            waiting()


def _parameters(node: Node, name: str) -> list[Parameter]:
    """All parameters of another node, but those of its QoS."""
    client = AsyncParameterClient(node, name)
    listed = client.list_parameters([], 0)
    _until(node, listed.done, name, 'parameters')
    names = [one for one in listed.result().result.names if not one.startswith('qos_overrides')]
    got = client.get_parameters(names)
    _until(node, got.done, name, 'parameters')
    return [
        Parameter.from_parameter_msg(ParameterMessage(name=one, value=value))
        for one, value in zip(names, got.result().values, strict=True)
    ]


def _until(node: Node, condition: Callable[[], Any], name: str, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise BvhTimeoutError(f"'{name}' sent no {what} within {PATIENCE:g} s")
        rclpy.spin_once(node, timeout_sec=0.1)
