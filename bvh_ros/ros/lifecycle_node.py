# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_lifecycle_node`: the same node, managed, so that Nav2's lifecycle manager can drive it.

- configure: read the parameters, compile, make an empty world;
- activate: subscribe to the sources, offer the services;
- deactivate: no subscription, no service. The world stays, as a paused costmap keeps its cells:
  lifetimes run on, and a required source has to speak again before queries are answered;
- cleanup: forget the world and the configuration.

Parameters are read-only, as those of `bvh_node` are: configuring again reads the same values. To
change them the node is started anew.
"""

from __future__ import annotations

import sys

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from bvh_ros.ros.node import run
from bvh_ros.ros.parameters import ConfigurationError
from bvh_ros.ros.private_rclpy import RCLError
from bvh_ros.ros.server import BvhServer
from bvh_ros.ros.texts import as_line

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
RESTART = 'parameters are read-only: to change them, start the node anew'


class BvhLifecycleNode(LifecycleNode):
    """Serves while it is active."""

    def __init__(self) -> None:
        super().__init__('bvh')
        self._server: BvhServer | None = None
        # In Jazzy a transition that the state does not have ends the node (ros2/rclpy#1209).
        for service in self.services:
            if service.srv_type is ChangeState:
                self._change_state = service.callback
                service.callback = self._change_state_or_refuse

    def _change_state_or_refuse(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return self._change_state(request, response)
        except RCLError as error:
            self.get_logger().error(f'transition refused: {error}')
            response.success = False
            return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters and compile; what cannot be used leaves the node unconfigured."""
        try:
            self._server = BvhServer(self)
        except ConfigurationError as error:
            self.get_logger().error(f'cannot be configured: {as_line(error)}; {RESTART}')
            return FAILURE
        self._server.compile(wholly=True)
        self.get_logger().info('configured; it answers once it is activated')
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen and answer."""
        assert self._server is not None, 'only a configured node is activated'
        try:
            self._server.serve()
        except ConfigurationError as error:
            self.get_logger().error(f'cannot be activated: {as_line(error)}; {RESTART}')
            return FAILURE
        self.get_logger().info('activated')
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening and answering; keep the world."""
        assert self._server is not None, 'only an active node is deactivated'
        self._server.stop()
        self.get_logger().info('deactivated: it neither listens nor answers; the world stays')
        return SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the world and the configuration."""
        self._forget()
        self.get_logger().info(f'cleaned up: the world is forgotten; {RESTART}')
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End, from whatever state."""
        self._forget()
        self.get_logger().info('shut down: start it anew to use it')
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin anew, unconfigured, after something went wrong in a transition."""
        self._forget()
        self.get_logger().error(f'a transition failed from {state.label}: unconfigured now')
        return SUCCESS

    def _forget(self) -> None:
        if self._server is not None:
            self._server.destroy()
            self._server = None


def main(args: list[str] | None = None) -> int:
    """Run the managed node until Ctrl-C or SIGTERM; return the exit code."""
    return run('bvh_lifecycle_node', BvhLifecycleNode, args)


if __name__ == '__main__':
    sys.exit(main())
