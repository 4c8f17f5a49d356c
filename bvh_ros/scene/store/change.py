# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A change of a scene that is under way, or was interrupted."""

UNFINISHED = (
    'a change of the scene was interrupted (or is under way): what it holds is not known before '
    'it is cleared'
)


class Change:
    """Around whatever is written to tree, columns, names and groups: they agree only at its end.

    Who is interrupted in between (Ctrl-C, MemoryError) leaves it `unfinished`; who asks meanwhile,
    from a signal handler or another thread, finds it so.
    """

    def __init__(self) -> None:
        self.unfinished = False

    def require_none(self) -> None:
        """RuntimeError if a change was interrupted, or is under way."""
        if self.unfinished:
            raise RuntimeError(UNFINISHED)

    def __enter__(self) -> None:
        self.require_none()
        self.unfinished = True

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.unfinished = kind is not None
