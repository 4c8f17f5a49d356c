# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report speed`: growth, calls, policies, searches, and what the first answer costs."""

from . import calls, cold_start, growth, policies, searches

INTRODUCTION = '## Speed'
SECTIONS = {
    'growth': growth.growth,
    'calls': calls.calls,
    'policies': policies.policies,
    'searches': searches.searches,
    'cold start': cold_start.cold_start,
    'cold start of a node': cold_start.kernels,
}
