import hashlib
import json
import os
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.errors import InputError
from robosim.experiments.jobs import Job, remove_folder, run_job
from robosim.experiments.keys import key_of
from robosim.experiments.results import this_machine
from robosim.files import alone_in
from tests.experiments.cheap import square

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def turned(value):
    """Return the same with all names in the opposite order."""
    if isinstance(value, dict):
        return {name: turned(value[name]) for name in reversed(value)}
    return [turned(one) for one in value] if isinstance(value, list) else value


@given(config=st.dictionaries(st.text(), VALUES, max_size=4))
def test_the_key_depends_on_what_a_configuration_says_and_not_on_how_it_is_written(config):
    key = Job(config).key
    assert len(key) == 64
    assert Job(turned(config)).key == key
    assert Job(json.loads(json.dumps(config))).key == key
    assert Job(config | {"one more": 1}).key != Job(config | {"one more": 2}).key


def test_keys_stay_what_they_are():
    plain = hashlib.sha256(b'{"name":"a","seed":1,"small":0.1}').hexdigest()
    assert Job({"seed": 1, "small": 0.1, "name": "a"}).key == plain
    assert key_of({"name": "a", "seed": 1, "small": 0.1}) == plain


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {1, 2}, object()])
def test_what_json_cannot_hold_is_a_sentence(value):
    with pytest.raises(InputError, match="a job's configuration must be numbers, texts, lists and tables: "):
        Job({"x": value}).key  # noqa: B018


def test_a_job_has_a_folder_of_its_own_and_goes_on_there(tmp_path):
    job = Job({"x": 3})
    first, again = (run_job(job, square, tmp_path) for _ in range(2))
    assert (first.figures["calls"], again.figures["calls"]) == ((1.0,), (2.0,))
    assert first.figures["square"] == again.figures["square"] == (9.0, 10.0)
    assert (first.key, first.config, first.wall_time, first.machine) == (
        job.key,
        {"x": 3},
        0.5,
        this_machine(),
    )
    assert [path.name for path in tmp_path.iterdir()] == [job.key[:16]]
    assert json.loads((job.folder(tmp_path) / "config.json").read_text()) == {"x": 3}
    assert run_job(Job({"x": 4}), square, tmp_path).figures["calls"] == (1.0,)


def test_two_processes_never_work_off_the_same_job(tmp_path):
    job = Job({"x": 3})
    seen = []

    def meanwhile(config, folder, report):
        child = os.fork()
        if not child:
            try:
                run_job(job, square, tmp_path)
            except InputError as error:
                (tmp_path / "said").write_text(str(error))
            os._exit(0)
        os.waitpid(child, 0)
        seen.append((tmp_path / "said").read_text())
        return square(config, folder, report)

    assert run_job(job, meanwhile, tmp_path).figures["calls"] == (1.0,)
    assert seen == [f"{job.folder(tmp_path)}: another process is at work in this folder."]
    assert run_job(job, square, tmp_path).figures["calls"] == (2.0,)


def test_a_folder_in_which_another_process_is_at_work_is_not_removed(tmp_path):
    job = Job({"x": 3})
    remove_folder(job, tmp_path)

    def meanwhile(config, folder, report):
        child = os.fork()
        if not child:
            remove_folder(job, tmp_path)
            os._exit(0)
        os.waitpid(child, 0)
        return square(config, folder, report)

    assert run_job(job, meanwhile, tmp_path).figures["calls"] == (1.0,)
    assert run_job(job, square, tmp_path).figures["calls"] == (2.0,)
    remove_folder(job, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_removed_while_a_job_waits_for_it_is_made_again(tmp_path):
    job = Job({"x": 3})
    folder = job.folder(tmp_path)
    run_job(job, square, tmp_path)
    # Not inherited by the child: it would hold the folder as well.
    held, hold = os.pipe()
    child = os.fork()
    if not child:
        os.read(held, 1)
        # It holds what has been removed meanwhile, and begins anew.
        calls = run_job(job, square, tmp_path, patience=30.0).figures["calls"]
        os._exit(0 if calls == (1.0,) else 1)
    with alone_in(folder):
        os.write(hold, b"x")
        time.sleep(0.3)
        folder.rename(tmp_path / "gone")
    assert os.waitpid(child, 0)[1] == 0
    assert (folder / "work" / "calls").read_text() == "x"
