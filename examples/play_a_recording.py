# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording: MarkerArrays of a ROS 2 bag into a scene, without ROS, and a question a message.

pip install 'bvh_ros[bags]' && python examples/play_a_recording.py my_bag
"""

from pathlib import Path

from needs import command_line, end_with

from bvh_ros.scene import Scene, Shapes

try:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    end_with("rosbags is missing: pip install 'bvh_ros[bags]'")

MARKERS, CUBE, ADD, DELETE = 'visualization_msgs/msg/MarkerArray', 1, 0, 2


def main(bag: Path) -> None:
    """Read the cubes, and print the obstacles within 5 m of the origin."""
    print(f'The cubes in the MarkerArrays of {bag.name}, and which are within 5 m of the origin.')
    scene, known = Scene(), set()
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [c for c in reader.connections if c.msgtype == MARKERS]
        if not connections:
            end_with(f'{bag} has no topic of {MARKERS}')
        for connection, stamp, raw in reader.messages(connections):
            markers = reader.deserialize(raw, connection.msgtype).markers
            cubes = [m for m in markers if m.type == CUBE and m.action == ADD]
            if cubes:
                poses = [m.pose for m in cubes]
                centres = [[getattr(p.position, axis) for axis in 'xyz'] for p in poses]
                turns = [[getattr(p.orientation, axis) for axis in 'xyzw'] for p in poses]
                turns = [turn if any(turn) else [0, 0, 0, 1] for turn in turns]  # as RViz does
                sizes = [[m.scale.x, m.scale.y, m.scale.z] for m in cubes]
                names = [f'{m.ns}/{m.id}' for m in cubes]
                for refusal in scene.update(
                    'bag', names, Shapes.boxes(centres, sizes, turns), stamp=stamp
                ):
                    print('refused:', refusal)
            scene.remove('bag', [f'{m.ns}/{m.id}' for m in markers if m.action == DELETE])
            near = [hit.name for hit in scene.overlap([0, 0, 0], [0, 0, 0], tolerance=5.0)]
            known.update(near)
            print(f't = {stamp / 1e9:.2f} s: {len(scene)} obstacles, within 5 m: {near}')
    print(
        f'{len(known)} obstacles came within 5 m of the origin; {len(scene)} are there at the end.'
    )


if __name__ == '__main__':
    parser = command_line(__doc__)
    parser.add_argument('bag', nargs='?', type=Path, help='a folder, .mcap or .db3')
    options = parser.parse_args()
    if options.bag is None or not options.bag.exists():
        end_with('name a bag that is there: python examples/play_a_recording.py my_bag')
    main(options.bag)
