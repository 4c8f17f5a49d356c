# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pictures of queries that docs/ shows can be drawn, and are those that are drawn."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / 'docs'


def test_docs_show_the_pictures_that_are_drawn(tmp_path: Path) -> None:
    pytest.importorskip('matplotlib', reason='extra [report] is not installed')
    subprocess.run([sys.executable, ROOT / '.ci' / 'query_pictures.py', tmp_path], check=True)
    files = [*tmp_path.iterdir()]
    texts = [page.read_text('utf-8') for page in DOCS.glob('*.md')]
    shown = {name for text in texts for name in re.findall(r'\]\(pictures/([^)]+)\)', text)}
    assert shown == {file.name for file in files}
    assert shown == {file.name for file in (DOCS / 'pictures').iterdir()}
    assert all('<svg' in file.read_text('utf-8') for file in files)
