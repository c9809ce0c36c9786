"""Files of the cache folder: only of this user, undamaged, and built again after a change."""

import json

import pytest

from mckibben.storage import private
from mckibben.storage.private import listing, read_private, write_private


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


def test_a_listing_is_built_once_and_again_after_a_change(tmp_path, monkeypatch):
    built, folder = [], tmp_path / "new" / "cache"

    def build():
        built.append(len(built))
        return {"number": built[-1]}

    assert [listing(folder, "laws", build) for _ in range(3)] == [{"number": 0}] * 3
    (file,) = folder.iterdir()
    assert json.loads(read_private(file)) == {"number": 0}
    assert listing(folder, "valves", build) == {"number": 1}
    monkeypatch.setattr(private, "SOURCES", ())
    assert listing(folder, "laws", build) == {"number": 2}
    assert listing(None, "laws", build) == {"number": 3}


def test_the_newest_files_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(private, "_MOST", 2)
    for number in range(4):
        write_private(tmp_path / f"{number}.program", b"")
        (tmp_path / f"{number}.program").touch()
    assert {one.name for one in tmp_path.iterdir()} == {"2.program", "3.program"}
