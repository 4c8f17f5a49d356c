# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_demo` in a process of its own."""

import re
import subprocess
import sys
from pathlib import Path

PATIENT = Path(__file__).with_name('patient_demo.py')
ROW = re.compile(r'^ *\d+\.\d  .+ +(free|\S+[/#]\d+.* \(.+, .+, .+\)) +\d+\.\d+$', re.MULTILINE)


def start(*arguments):
    """Begin a demo."""
    command = [sys.executable, PATIENT, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(process):
    """Exit code, table, and what else was said."""
    output, errors = process.communicate(timeout=3000)
    assert 'Traceback' not in errors
    return process.returncode, output, errors


def rows_of(output):
    """The rows of a table."""
    return [row[0] for row in ROW.finditer(output)]
