"""Files appear whole or not at all, whatever ends their writing."""

import os
import resource
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clcache.errors import Error, SettingError
from clcache.output.files import atomic_path, check_target


@given(st.lists(st.tuples(st.binary(max_size=64), st.sampled_from([None, ValueError, KeyboardInterrupt, SystemExit]))))
def test_a_file_is_what_the_last_complete_writing_made_it(tmp_path_factory, writings):
    path = tmp_path_factory.mktemp("folder") / "file.bin"
    expected = None
    for data, failure in writings:
        try:
            with atomic_path(path) as part:
                part.write_bytes(data)
                if failure is not None:
                    raise failure
            expected = data
        except (ValueError, KeyboardInterrupt, SystemExit):
            assert failure is not None
        assert [p.name for p in path.parent.iterdir()] == ([] if expected is None else ["file.bin"])
        assert expected is None or path.read_bytes() == expected


def test_nothing_is_at_the_path_before_the_end(tmp_path):
    path = tmp_path / "new" / "folder" / "file.bin"
    with atomic_path(path) as part:
        part.write_bytes(b"half")
        assert part.parent == path.parent
        assert not path.exists()
    assert path.read_bytes() == b"half"


def test_who_reads_the_old_file_keeps_it(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with path.open("rb") as reader:
        with atomic_path(path) as part:
            part.write_bytes(b"new")
        assert reader.read() == b"old"
    assert path.read_bytes() == b"new"


def test_a_full_disk_is_one_error_and_leaves_what_was_there(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with (
            pytest.raises(Error, match=r"file\.bin: cannot be written: File too large") as caught,
            atomic_path(path) as part,
        ):
            part.write_bytes(bytes(10_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert type(caught.value) is Error
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file.bin"]


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    with atomic_path(tmp_path / "whole") as part:
        part.write_bytes(b"")
    assert stat.S_IMODE((tmp_path / "whole").stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "file")
    with atomic_path(tmp_path / "link") as part:
        part.write_bytes(b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"new"


def test_names_that_no_file_can_have_are_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    refused = ["", "file/below.png", "n" * 300, "nul\0byte"]
    for name in refused:
        with pytest.raises(SettingError, match="expected"):
            check_target(tmp_path / name)
    with pytest.raises(SettingError, match="no regular file"):
        check_target(Path(os.devnull))
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(SettingError, match="cannot be written to"):
        check_target(tmp_path / "file")
