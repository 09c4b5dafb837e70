"""Compiled code is loaded from a folder only where no other user could have put it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from errpipe import kernels


@pytest.fixture
def where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No home to write in: only the temporary folder, which is everybody's."""
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    monkeypatch.setattr(kernels.tempfile, "gettempdir", lambda: str(tmp_path))
    return tmp_path / f"errpipe-numba-{os.getuid()}"


def test_a_fresh_folder_is_private(where: Path) -> None:
    assert kernels._cache_folder() == str(where)
    assert where.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_could_read_is_made_private(where: Path) -> None:
    where.mkdir(mode=0o755)
    assert kernels._cache_folder() == str(where)
    assert where.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o1777])
def test_a_folder_that_others_could_write_is_not_used(where: Path, mode: int) -> None:
    where.mkdir()
    where.chmod(mode)
    assert kernels._cache_folder() is None


def test_a_link_is_not_used(where: Path, tmp_path: Path) -> None:
    (tmp_path / "planted").mkdir(mode=0o700)
    where.symlink_to(tmp_path / "planted")
    assert kernels._cache_folder() is None


@pytest.mark.skipif(os.getuid() != 0, reason="only root can make a folder of somebody else's")
def test_a_folder_of_somebody_else_is_not_used(where: Path) -> None:
    where.mkdir(mode=0o700)
    os.chown(where, 12345, 12345)
    assert kernels._cache_folder() is None


def test_a_folder_that_others_could_swap_is_not_used(where: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    assert kernels._cache_folder() is None
    tmp_path.chmod(0o1777)  # as /tmp is: others can add, not rename
    assert kernels._cache_folder() == str(where)


def test_without_a_folder_kernels_compile_without_a_cache(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(kernels, "_cache_folder", lambda: None)
    double = kernels.kernel(lambda x: 2 * x)
    assert double(21) == 42 and "NUMBA_CACHE_DIR" not in os.environ


CALL = "import numpy as np; from errpipe.kernels.responses import first_value as f; f(np.zeros(3, int), np.ones(3))"


@pytest.mark.slow
def test_where_there_is_no_temporary_folder_nothing_is_kept(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(kernels.tempfile, "gettempdir", full)
    assert kernels._cache_folder() is None


@pytest.mark.slow
def test_a_planted_index_runs_in_no_process(tmp_path: Path) -> None:
    """End to end: read from a folder that is ours alone the planted index runs; from one that others write, never."""
    temporary, ran = tmp_path / "tmp", tmp_path / "ran"
    temporary.mkdir(mode=0o700)
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2]), "XDG_CACHE_HOME": "/proc/none"}
    env |= {"TMPDIR": str(temporary)}
    env.pop("NUMBA_CACHE_DIR", None)

    def call() -> None:
        subprocess.run([sys.executable, "-c", CALL], env=env, capture_output=True, timeout=300)

    call()
    (folder,) = temporary.iterdir()
    indices = list(folder.rglob("*.nbi"))
    assert indices, "the first process keeps what it compiled"
    for path in indices:
        index = path.read_bytes()
        head = index[: index.index(b"\x94.") + 2]  # the version of Numba; behind it stands what is read next
        path.write_bytes(head + f"cos\nmkdir\n(S'{ran}'\ntR.".encode())  # read, it makes a folder
    call()
    assert ran.exists(), "the plant is none: it must run where the folder is trusted"
    ran.rmdir()
    folder.chmod(0o777)
    call()
    assert not ran.exists()
    folder.chmod(0o700)
    folder.rename(temporary / "elsewhere")
    (temporary / folder.name).symlink_to(temporary / "elsewhere")
    call()
    assert not ran.exists()


@pytest.mark.slow
def test_two_installations_share_what_was_compiled(tmp_path: Path) -> None:
    root, cache = Path(__file__).parents[2], tmp_path / "cache"
    shutil.copytree(root / "errpipe", tmp_path / "copy" / "errpipe", ignore=shutil.ignore_patterns("__pycache__"))
    kept = []
    for path in (root, tmp_path / "copy"):
        env = os.environ | {"PYTHONPATH": str(path), "NUMBA_CACHE_DIR": str(cache)}
        subprocess.run([sys.executable, "-c", CALL], env=env, cwd=path, check=True, timeout=300)
        kept.append({file: file.stat().st_mtime_ns for file in cache.rglob("*.nb?")})
    assert kept[0] and kept[1] == kept[0]
