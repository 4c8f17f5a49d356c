# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report speed`: growth, policies, searches, and what the first answer costs."""

from . import cold_start, growth, policies, searches

INTRODUCTION = '## Speed'
SECTIONS = {
    'growth': growth.growth,
    'policies': policies.policies,
    'searches': searches.searches,
    'cold start': cold_start.cold_start,
    'cold start of a node': cold_start.kernels,
}
