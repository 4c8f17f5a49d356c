# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the node does, on any rclpy node: reads parameters, compiles, listens and answers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

from rclpy.exceptions import InvalidTopicNameException, NameValidationException, ParameterException
from rclpy.validate_full_topic_name import validate_full_topic_name

from bvh_ros.ros.compilation import Compilation
from bvh_ros.ros.compile_jobs import Job, Needs, jobs, later_jobs, path_jobs
from bvh_ros.ros.parameters import (
    GROUPS,
    ConfigurationError,
    draw_settings,
    read_settings,
    scan_settings,
)
from bvh_ros.ros.parts.diagnostics import Diagnostics, Maintenance, NamesPublisher
from bvh_ros.ros.parts.drawing import QueryDrawing, SceneDrawing, TreeDrawing
from bvh_ros.ros.parts.readiness import OnDemand, Readiness
from bvh_ros.ros.parts.services import QueryServices, TriggerServices
from bvh_ros.ros.qos import check_overrides
from bvh_ros.ros.sources import SOURCE_TYPES, create_source
from bvh_ros.ros.texts import as_line, shortened
from bvh_ros.ros.world.frames import Frames, listen_to_tf2
from bvh_ros.ros.world.known_times import known_times
from bvh_ros.ros.world.large_changes import LargeChanges
from bvh_ros.ros.world.views import Categoriser, View, create_views, view_of_scan
from bvh_ros.ros.world.world import ClockJumps, World
from bvh_ros.scene import AS_CONVEX, NodeScene, ShapeKind

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.parameters import SourceSettings
    from bvh_ros.ros.parts.batches import Batch
    from bvh_ros.ros.parts.typed_services import TypedServices
    from bvh_ros.ros.parts.virtual_scan import VirtualScan
    from bvh_ros.ros.sources.mesh_resources import MeshFiles
    from bvh_ros.ros.sources.source import Source


def has_typed_services() -> bool:
    """Whether the package bvh_msgs is installed."""
    spec = find_spec('bvh_msgs')
    return spec is not None and spec.origin is not None  # else a folder of sources


@contextlib.contextmanager
def _refusing(what: str) -> Iterator[None]:
    """Let a ConfigurationError say what a name or QoS that rclpy refuses is given by."""
    try:
        yield
    except (RuntimeError, InvalidTopicNameException, ParameterException) as error:
        raise ConfigurationError(f'{what}: {as_line(error)}') from error


class Destroyable(Protocol):
    """All that the server asks of a part."""

    def destroy(self) -> None:
        """Take away everything that this part opened on the node."""


class BvhServer:
    """Keeps moving obstacles in a dynamic bounding volume hierarchy and answers queries.

    Its life: made (parameters read), `compile`, then `serve` and `stop` as often as wanted, and
    `destroy` in the end.

    Parameters
    ----------
    node : rclpy.node.Node
        Any node, managed or not.

    Raises
    ------
    ConfigurationError
        If a parameter cannot be used.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        types = {name: kind.options for name, kind in SOURCE_TYPES.items()}
        self.settings = settings = read_settings(node, types, GROUPS)
        self._draw = draw_settings(settings.groups['draw'])
        self._scan = scan_settings(settings.groups['virtual_scan'])
        self._parts: list[Destroyable] = []
        self._ends: list[Destroyable] = []  # what lives as long as the world
        self._tf2 = listen_to_tf2(node) if settings.use_tf else None
        if self._tf2 is not None:
            self._ends.append(self._tf2)
        try:
            self.world = self._create_world()
            self._check_scan()
            check_overrides(node, [*self._topics()])
        except ConfigurationError:
            self.destroy()
            raise
        self._ends.append(ClockJumps(node, self.world))

    def _create_world(self) -> World:
        settings, kinds = self.settings, self._kinds()
        scene = NodeScene(
            planar=settings.planar,
            margin=settings.margin,
            max_obstacles=settings.max_obstacles,
            categorise=Categoriser(settings.views) if settings.views else None,
            meshes=ShapeKind.MESH in kinds,
            any_mesh=self._any_mesh(),
            region=settings.region,
            max_prediction=settings.max_prediction,
            uncertainty=settings.uncertainty,
        )
        frames = Frames(settings.frame_id, self._tf2, settings.transforms)
        sources = [self._create_source(given, scene, frames) for given in settings.sources]
        changes = LargeChanges(scene)
        for source in sources:
            source.changes, source.mesh_files = changes, self._mesh_files
        times = known_times(changes, sources, settings)
        return World(settings, changes, frames, sources, self._create_views(), times)

    def _mesh_files(self) -> MeshFiles:
        from bvh_ros.ros.sources.mesh_resources import MeshFiles

        most = round(1e6 * self.settings.mesh_megabytes)
        return MeshFiles(self.settings.mesh_paths, self.settings.mesh_limit, most)

    def _topics(self) -> Iterator[str]:
        """The topics that this configuration subscribes and whose QoS can be overridden."""
        topics = [source.settings.topic for source in self.world.sources]
        if self.settings.batch:
            names = 'rays', 'boxes', 'points', *(['paths'] if self.settings.footprint else [])
            topics += [view.topic(name) for view in self.world.views for name in names]
        if self._scan.pose_topic:
            topics.append(self._scan.pose_topic)
        for topic in topics:
            with contextlib.suppress(RuntimeError, InvalidTopicNameException):  # said later
                yield self.node.resolve_topic_name(topic)

    def _check_scan(self) -> None:
        """Raise ConfigurationError if the topic or view of the scan cannot be used."""
        if not self._scan.pose_topic:
            return
        view_of_scan(self.world.views, self._scan.view)
        with _refusing("parameter 'virtual_scan.pose_topic'"):
            self.node.resolve_topic_name(self._scan.pose_topic)

    def _kinds(self) -> set[ShapeKind]:
        """Return the shapes that the sources can bring."""
        return {kind for s in self.settings.sources for kind in SOURCE_TYPES[s.type].kinds}

    def _any_mesh(self) -> bool:
        """Whether sources can bring meshes that are not convex."""
        forms = (source.options.get('meshes', AS_CONVEX) for source in self.settings.sources)
        return any(form != AS_CONVEX for form in forms)

    def compile(self, *, wholly: bool = False) -> None:
        """Compile the kernels that this configuration needs. Where that takes long, only those for
        the first answers, unless `wholly`: the rest is compiled beside the node, while it serves.
        """
        compilation = Compilation(self.jobs())
        readiness = Readiness(self.node, self.world, compilation, self._say_ready)
        self._ends.append(readiness)
        readiness.begin(wholly=wholly)

    def jobs(self, *, wholly: bool = False) -> list[Job]:
        """Return what compiles the kernels that this configuration needs; `wholly` with those
        of first use.
        """
        of_sources = [job for source in self.world.sources for job in source.to_compile()]
        needs, footprint = self.needs(), self.settings.footprint
        chosen, paths = jobs(needs), []
        if self.settings.batch and footprint:
            has_meshes = footprint[0].mesh is not None
            paths = path_jobs(needs, meshes=has_meshes, between=self.settings.path_between)
        early, later = [job for job in chosen if job.early], later_jobs(needs) if wholly else []
        return [*early[:2], *of_sources, *early[2:], *chosen[len(early) :], *paths, *later]

    def needs(self) -> Needs:
        return Needs(
            planar=self.settings.planar,
            margin=self.settings.margin,
            kinds=sorted(self._kinds()),
            batch=self.settings.batch or bool(self._scan.pose_topic),
            threads=self.settings.threads,
            moving=self.settings.predicts,
            any_mesh=self._any_mesh(),
        )

    def serve(self) -> None:
        """Listen to the sources and offer the services; what updates and the first answers need is
        compiled by now.

        Raises
        ------
        ConfigurationError
            If a part cannot be had as configured; none is there then.
        """
        try:
            for source in self.world.sources:
                self._parts.append(source)
                self._subscribe(source)
            self._parts.extend(self._create_parts())
        except Exception:
            self.stop()
            raise
        if not self.world.compiling:
            self._say_ready()

    def _say_ready(self) -> None:
        self.node.get_logger().info(self.in_words())

    def _create_parts(self) -> Iterator[Destroyable]:
        """Create the parts that this configuration uses, a line each; the last ends first."""
        node, world = self.node, self.world
        drawing = QueryDrawing(node, world, self._draw)
        yield drawing
        kernels = OnDemand(node, later_jobs(self.needs()))
        yield kernels
        # Before the services: a client that gets an answer knows which run of the node it is of.
        yield NamesPublisher(node, world)
        queries: list[QueryServices] = []
        for view in world.views:
            queries.append(QueryServices(node, world, view, drawing, kernels))
            yield queries[-1]
        yield TriggerServices(node, world)
        answerers: list[Batch | TypedServices | VirtualScan] = []
        for answerer in self._create_answerers(drawing, kernels):
            answerers.append(answerer)
            yield answerer
        yield SceneDrawing(node, world, self._draw)
        yield TreeDrawing(node, world, self._draw)
        yield Maintenance(node, world)
        yield Diagnostics(node, world, queries, answerers, self.features)

    def _create_answerers(
        self, drawing: QueryDrawing, kernels: OnDemand
    ) -> Iterator[Batch | TypedServices | VirtualScan]:
        """Create the parts that answer batches; none of it is imported where there are none."""
        node, world = self.node, self.world
        if self.settings.batch:
            from bvh_ros.ros.parts.batches import (
                BoxBatch,
                PathBatch,
                PointBatch,
                RayBatch,
                SweepBatch,
            )

            path_batch = SweepBatch if self.settings.path_between else PathBatch
            for view in world.views:
                yield RayBatch(node, world, view, kernels, drawing)
                yield BoxBatch(node, world, view, kernels)
                yield PointBatch(node, world, view, kernels)
                if self.settings.footprint:
                    yield path_batch(node, world, view, kernels, self.settings.footprint)
            if has_typed_services():
                from bvh_ros.ros.parts.typed_services import TypedServices

                for view in world.views:
                    yield TypedServices(node, world, view, kernels)
        if self._scan.pose_topic:
            from bvh_ros.ros.parts.virtual_scan import VirtualScan

            view = view_of_scan(world.views, self._scan.view)
            with _refusing("parameter 'virtual_scan.pose_topic'"):
                scan = VirtualScan(node, world, self._scan, view)
            yield scan

    def stop(self) -> None:
        """End all parts: no topic is heard and no service offered. The world stays as it is."""
        while self._parts:
            self._parts.pop().destroy()

    def destroy(self) -> None:
        """Leave nothing behind on the node but its parameters."""
        self.stop()
        while self._ends:
            self._ends.pop().destroy()

    def in_words(self) -> str:
        """Say what is served and which parts this scene uses."""
        settings, world = self.settings, self.world
        heard = ', '.join(
            f'{source.name} ({source.settings.type} on {source.subscription.topic}'
            f'{", decoded here" if source.raw else ""})'
            for source in world.sources
            if source.subscription is not None
        )
        parts = self.features()
        on, off = (
            ', '.join(part for part in parts if parts[part] is used) for used in (True, False)
        )
        return (
            f"ready in frame '{shortened(settings.frame_id)}'; sources: {heard or 'none'}; "
            f'on: {on}; off: {off}'
        )

    def features(self) -> dict[str, bool]:
        """Tell which parts this configuration and scene use, in words."""
        settings = self.settings
        margin, views, threads = settings.margin, len(settings.views), settings.threads
        shaped = self.world.scene.any_shaped
        return {
            '2D tree of footprints' if settings.planar else '3D tree': True,
            f'margin of {margin:g} m' if margin else 'margin': margin > 0.0,
            'region' if settings.region else 'region of its own': settings.region is not None,
            f'{views} views' if views else 'views': views > 0,
            'batches of rays': settings.batch,
            'paths between poses': bool(settings.footprint) and settings.path_between,
            'typed services': settings.batch and has_typed_services(),
            f'{threads} threads' if threads > 1 else 'threads': threads > 1,
            'other times than now': self.world.times is not None,
            'virtual scan': bool(self._scan.pose_topic),
            'tf2': self._tf2 is not None,
            'narrow phase'
            if shaped
            else 'narrow phase until a turned or round shape comes': shaped,
        }

    def _create_source(self, settings: SourceSettings, scene: NodeScene, frames: Frames) -> Source:
        with _refusing(f"source '{settings.name}', parameter '{settings.name}.topic'"):
            self.node.resolve_topic_name(settings.topic)  # better known before compiling
        return create_source(self.node, settings, scene, frames)

    def _create_views(self) -> list[View]:
        views = create_views(self.settings.views)
        for view in views:
            try:
                name = self.node.resolve_service_name(view.topic('raycast_all'))
                validate_full_topic_name(name, is_service=True)
            except (RuntimeError, NameValidationException) as error:
                reason = str(error).partition('\n')[0]
                raise ConfigurationError(f"view '{view.name}': {reason}") from error
        return views

    @staticmethod
    def _subscribe(source: Source) -> None:
        try:
            source.subscribe()
        except (RuntimeError, ParameterException) as error:  # QoS overrides that make no sense
            raise ConfigurationError(f"source '{source.name}': {error}") from error
