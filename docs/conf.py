# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sphinx: `pip install '.[docs]' && sphinx-build -W docs build/docs`."""

from importlib.util import find_spec

project = 'bvh_ros'
author = 'The bvh_ros authors'
copyright = '2026, ' + author
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
html_theme = 'furo'
# Lines of 100 characters fit beside the menus.
html_theme_options = {'light_css_variables': {'code-font-size': '76%'}}
myst_heading_anchors = 3
autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
# The client is documented from its source also where ROS is not installed.
ROS = ('rclpy', 'nav_msgs', 'sensor_msgs', 'std_srvs', 'geometry_msgs', 'diagnostic_msgs')
autodoc_mock_imports = [name for name in ROS if find_spec(name) is None]
