# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ask a running bvh node from Python: plain numbers and arrays in and out.

```python
client = BvhClient(node)
client.wait_until_ready()
hit = client.raycast((0, 0, 1), (10, 0, 1))
print('free' if hit is None else f'{hit.name} at {hit.point}')
hits = client.raycast_many(origins, directions)  # arrays (n, 3): a hundred thousand at once
print(client.names(hits.obstacles))
```
"""

from bvh_ros.client.client import BvhClient
from bvh_ros.client.messages import COMPILING, BvhError, BvhTimeoutError, Clearances, Hit, Sweeps
from bvh_ros.ros.conversions.query_clouds import FREE, UNANSWERED, Hits, Near, PathHits, Touched

__all__ = [
    'COMPILING',
    'FREE',
    'UNANSWERED',
    'BvhClient',
    'BvhError',
    'BvhTimeoutError',
    'Clearances',
    'Hit',
    'Hits',
    'Near',
    'PathHits',
    'Sweeps',
    'Touched',
]
