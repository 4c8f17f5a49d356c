# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the client raises."""


class BvhError(RuntimeError):
    """The node could not answer; the text is the node's reason."""


class BvhTimeoutError(BvhError):
    """No answer came in time."""
