"""Programs of the cache folder: only of this user, undamaged, and the newest."""

import pytest

from mckibben.storage.private import read_private, write_private


def test_what_is_written_is_read_back_unless_a_byte_is_damaged(tmp_path):
    path = tmp_path / "a.program"
    write_private(path, b"content")
    assert read_private(path) == b"content" and path.stat().st_mode & 0o777 == 0o600
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(ValueError):
            read_private(path)
    path.write_bytes(whole)
    path.chmod(0o620)  # others could have changed it
    with pytest.raises(PermissionError):
        read_private(path)


def test_the_newest_files_are_kept(tmp_path):
    for number in range(4):
        write_private(tmp_path / f"{number}.program", b"", most=2)
        (tmp_path / f"{number}.program").touch()
    assert {file.name for file in tmp_path.iterdir()} == {"2.program", "3.program"}
