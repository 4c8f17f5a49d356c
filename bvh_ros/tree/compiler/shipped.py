# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code that was compiled before, say for an image, and is read but never written.

`bvh_warm_up FOLDER` makes it. It is looked for in `$BVH_ROS_KERNELS` (empty: nowhere), else in the
folder `kernels` of the installed package, and holds for each processor that it was compiled for a
folder with a manifest. What fits this processor, numba, Python and these sources is used.
Otherwise one line says why not, and kernels are compiled.
"""

import contextlib
import functools
import json
import os
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from . import kernel_sources

# ---- A folder that only this user can write
#
# A user who can write machine code that others run can run anything in their name. So a folder in
# the machine's temporary folder, or in a borrowed home, is trusted only after a look at its owner.


DRAFT = '.tmp'  # ends the names of files that are being written
ABANDONED = 600.0  # seconds; writing takes milliseconds


class UnsafeError(PermissionError):
    """Others could have written here."""


def is_ours_alone(status: os.stat_result, *, or_of_root: bool = False) -> bool:
    """Whether a file or folder is this user's, and no other user may write it. With `or_of_root`
    those of root will do, too: root needs no such file to run anything.
    """
    if os.name == 'nt':
        return True  # knows no such modes
    owners = (os.geteuid(), 0) if or_of_root else (os.geteuid(),)
    return status.st_uid in owners and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def open_private(ours: Path, name: str) -> Path:
    """Return the folder `name` in our own one; both are made where they are missing, and what was
    never written to its end is removed.

    What is above our own folder is the machine's, and not looked at.

    Raises
    ------
    UnsafeError
        If one of the two is a link, another user's, or can be written by others.
    OSError
        If no file can be written there.
    """
    for above in reversed(ours.parents):
        if not above.exists():
            above.mkdir(mode=0o700, exist_ok=True)
    folder = ours / name
    for part in ours, folder:
        part.mkdir(mode=0o700, exist_ok=True)
        check(part)
    for draft in folder.glob(f'*{DRAFT}'):  # of processes that ended while they wrote
        with contextlib.suppress(OSError):
            if time.time() - draft.stat().st_mtime > ABANDONED:
                draft.unlink()
    with tempfile.TemporaryFile(dir=folder):
        return folder


def check(folder: Path, *, or_of_root: bool = False) -> None:
    """Raise UnsafeError if a folder is a link, another user's, or can be written by others."""
    status = folder.lstat()
    if stat.S_ISLNK(status.st_mode):
        raise UnsafeError(f'{folder} is a link')
    if not is_ours_alone(status, or_of_root=or_of_root):
        raise UnsafeError(
            f'{folder} has mode {stat.S_IMODE(status.st_mode):o} and belongs to user'
            f' {status.st_uid}; only user {os.geteuid()} may write there'
        )


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that others see whole or not at all."""
    descriptor, draft = tempfile.mkstemp(dir=path.parent, suffix=DRAFT)
    try:
        with open(descriptor, 'wb') as file:
            file.write(content)
        os.replace(draft, path)
    except BaseException:
        os.unlink(draft)
        raise


# ---- Machine code that was compiled before, and is only read


VARIABLE = 'BVH_ROS_KERNELS'
IN_PACKAGE = kernel_sources.PACKAGE / 'kernels'
MANIFEST = 'kernels.json'
# What a processor of each level has, as LLVM names it (x86-64 psABI, "microarchitecture levels").
_V2 = ('cx16', 'popcnt', 'sahf', 'sse3', 'sse4.1', 'sse4.2', 'ssse3')
_V3 = (*_V2, 'avx', 'avx2', 'bmi', 'bmi2', 'f16c', 'fma', 'lzcnt', 'movbe')
_V4 = (*_V3, 'avx512f', 'avx512bw', 'avx512cd', 'avx512dq', 'avx512vl')
LEVELS = {'x86-64-v2': _V2, 'x86-64-v3': _V3, 'x86-64-v4': _V4}
_OF_THE_PROCESSOR = 'CPU_NAME=', 'CPU_FEATURES=', 'ENABLE_AVX='  # compared by what it can do

Codegen = tuple[str, str, str]  # triple, processor and features, as numba names machine code by


class Shipped(NamedTuple):
    """A folder of machine code that fits."""

    folder: Path
    codegen: Codegen


def host_features() -> Mapping[str, bool]:
    """What this processor has, by LLVM's names."""
    import llvmlite.binding as llvm

    found: Mapping[str, bool] = llvm.get_host_cpu_features()
    return found


def missing_features(wanted: Sequence[str]) -> list[str]:
    """Return what this processor has not got."""
    here = host_features()
    return [feature for feature in wanted if not here.get(feature, False)]


def finish(folder: Path, settings: Sequence[str], codegen: Codegen) -> None:
    """Write the manifest of a folder that was compiled with these settings, and let all read it:
    only its maker can write there.
    """
    named = LEVELS.get(codegen[1])
    features = [word[1:] for word in codegen[2].split(',') if word.startswith('+')]
    content = {
        **_here(settings),
        'codegen': codegen,
        'features': sorted(features if named is None else named),
    }
    (folder / MANIFEST).write_text(json.dumps(content, indent=1) + '\n')
    for path in (folder.parent, folder):
        path.chmod(0o755)
    for path in folder.iterdir():
        path.chmod(0o644)


@functools.cache
def find(settings: tuple[str, ...]) -> Shipped | None:
    """Return the folder that fits these settings and this machine, of several the one that asks
    most of the processor.
    """
    fitting: list[tuple[int, Shipped]] = []
    reasons: list[str] = []
    place = _place()
    if place is None:
        return None
    for folder in _folders(place):
        try:
            check(folder.parent, or_of_root=True)
            check(folder, or_of_root=True)
            content = json.loads((folder / MANIFEST).read_text())
            reason = _misfit(content, settings)
            if not reason:
                triple, processor, features = content['codegen']
                found = Shipped(folder, (triple, processor, features))
                fitting.append((len(content['features']), found))
        except UnsafeError as error:
            reason = str(error)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            reason = f'{folder / MANIFEST} cannot be read'
        reasons.append(reason)
    if fitting:
        return max(fitting)[1]
    if reasons or os.environ.get(VARIABLE):
        why = '; '.join(reasons) or 'there are none'
        warnings.warn(
            f'the kernels in {place} are not used, others are compiled: {why}',
            RuntimeWarning,
            stacklevel=2,
        )
    return None


def _place() -> Path | None:
    named = os.environ.get(VARIABLE)
    if named is None:
        return IN_PACKAGE
    return Path(named).absolute() if named else None


def _folders(place: Path) -> Iterator[Path]:
    try:
        yield from sorted(path.parent for path in (place / 'bvh_ros').glob(f'*/{MANIFEST}'))
    except OSError:
        return


def _here(settings: Sequence[str]) -> dict[str, Any]:
    """What has to be the same where kernels are compiled and where they run."""
    return {
        'Python': f'{sys.implementation.cache_tag}{sys.abiflags}',
        'sources': kernel_sources.digest_of_all(),
        'numba, llvmlite and their settings': [
            setting for setting in settings if not setting.startswith(_OF_THE_PROCESSOR)
        ],
    }


def _misfit(content: dict[str, Any], settings: Sequence[str]) -> str:
    """Say what differs, or nothing."""
    for what, here in _here(settings).items():
        if content[what] != here:
            return f'they were compiled with other {what}'
    if missing := missing_features(content['features']):
        return f'this processor has no {", ".join(missing)}'
    return ''
