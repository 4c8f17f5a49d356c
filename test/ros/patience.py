# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long tests wait for what comes for certain, however slow the machine is."""

PATIENCE = 600.0  # seconds, against hanging; an answer takes milliseconds of a processor
COMPILING = 2400.0  # seconds, where kernels are compiled first: minutes of a processor
