"""Checksums at the end of files, and folders that can no longer be written to."""

import errno
import os
import shutil

import pytest

from mckibben.errors import FileError
from mckibben.storage.files import check_seal, explain_write_errors, make_subfolder, sealed, sync_folder


def test_any_flipped_bit_of_a_sealed_file_is_found(tmp_path):
    path, content = tmp_path / "file", b"estimate: 12.5\n" * 3
    whole = sealed(content)
    path.write_bytes(whole)
    check_seal(path)
    assert whole.startswith(content)
    for place in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        path.write_bytes(damaged)
        if place < 8 * len(content):
            with pytest.raises(FileError, match="it has changed since it was written") as caught:
                check_seal(path)
            assert "sha256" in caught.value.problems[0].remedy


@pytest.mark.parametrize("content", [b"", b"law: ExponentialLaw\n", b"# sha256 of something else\n", b"x" * 74])
def test_a_file_without_a_seal_passes(tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    check_seal(tmp_path / "file")


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO])
def test_a_disk_that_takes_no_more_says_what_is_kept(tmp_path, number):
    with pytest.raises(FileError) as caught, explain_write_errors(tmp_path, lambda: "3 runs are kept", "make room"):
        raise OSError(number, os.strerror(number))
    (problem,) = caught.value.problems
    assert problem.message.endswith("; 3 runs are kept")
    assert problem.remedy == "make room"


def test_a_folder_that_has_vanished_keeps_nothing(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    with pytest.raises(FileError, match="has disappeared"), explain_write_errors(folder, lambda: "all is kept", "none"):
        shutil.rmtree(folder)
        sync_folder(folder)
    with pytest.raises(FileNotFoundError), explain_write_errors(tmp_path, lambda: "", ""):
        (tmp_path / "missing").read_bytes()


def test_a_link_to_another_folder_is_not_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "tuning").symlink_to("elsewhere")
    with pytest.raises(FileError) as caught:
        make_subfolder(tmp_path, "tuning")
    assert caught.value.problems[0].field == "tuning"
    assert make_subfolder(tmp_path, "figures").is_dir()
