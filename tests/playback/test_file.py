import errno

import pytest
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from robosim.errors import InputError
from robosim.playback.file import recording_file, require_space


def _open(path):
    return recording_file(path, rrb.Blueprint(rrb.TextLogView()), "a test")


def test_recording_appears_only_when_its_block_has_ended(tmp_path):
    path = tmp_path / "run.rrd"
    with _open(path):
        assert not path.exists()
    reader = RrdReader(path)
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    assert list(tmp_path.iterdir()) == [path]


def test_an_exception_leaves_the_folder_as_it_was(tmp_path):
    path = tmp_path / "run.rrd"
    path.write_bytes(b"an older run")
    with pytest.raises(RuntimeError, match="broken"), _open(path):
        raise RuntimeError("broken")
    assert path.read_bytes() == b"an older run"
    assert list(tmp_path.iterdir()) == [path]


def test_an_older_recording_is_replaced(tmp_path):
    path = tmp_path / "run.rrd"
    path.write_bytes(b"an older run")
    with _open(path):
        pass
    assert len(RrdReader(path).recordings()) == 1


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("run.mp4", "the file name must end in .rrd, the viewer's format."),
        (
            "nowhere/run.rrd",
            "cannot be written (No such file or directory); name a file in an existing folder",
        ),
        ("a_file/run.rrd", "cannot be written (Not a directory); name a file in an existing folder"),
        ("folder.rrd", "this is a folder; give the name of a file in it."),
    ],
)
def test_a_path_that_cannot_be_written_is_one_sentence(tmp_path, name, sentence):
    (tmp_path / "folder.rrd").mkdir()
    (tmp_path / "a_file").touch()
    with pytest.raises(InputError) as caught, _open(tmp_path / name):
        pytest.fail("the block must not run")
    assert str(caught.value).startswith(f"Recording {str(tmp_path / name)!r}: {sentence}")
    assert "\n" not in str(caught.value)


def test_a_full_disk_is_reported_before_it_is_written_to(tmp_path):
    require_space(tmp_path, 1)
    with pytest.raises(
        OSError, match="the disk is full: the recording needs 1000000000000 MB more, "
    ) as caught:
        require_space(tmp_path, 10**18)
    assert caught.value.errno == errno.ENOSPC
    assert caught.value.filename == str(tmp_path)
