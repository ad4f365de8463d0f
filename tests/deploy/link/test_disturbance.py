"""A link that is bad on purpose."""

import time

from robosim.deploy.link.disturbance import Disturbance, Disturber


def sent(count, name="robot-0", **what):
    """Send numbers through a process's disturber; return what has come out, in order, and when."""
    came = []
    disturber = Disturber(
        name, Disturbance(**what), lambda key, data: came.append((int(data), time.monotonic()))
    )
    began = time.monotonic()
    for number in range(count):
        disturber.put("key", b"%d" % number)
    time.sleep(what.get("delay", 0.0) + what.get("jitter", 0.0) + 0.15)
    disturber.close()
    return [number for number, _ in came], [at - began for _, at in came]


def test_messages_get_lost_and_come_twice_about_as_often_as_asked():
    numbers, _ = sent(1000, loss=0.2)
    assert 740 < len(numbers) < 860
    assert numbers == sorted(numbers)
    twice, _ = sent(1000, doubled=0.3)
    assert 1240 < len(twice) < 1360
    assert set(twice) == set(range(1000))


def test_messages_are_late_and_overtake_each_other():
    numbers, times = sent(50, delay=0.1)
    assert numbers == list(range(50))
    assert min(times) >= 0.1
    numbers, _ = sent(50, jitter=0.1)
    assert numbers != sorted(numbers)
    assert set(numbers) == set(range(50))


def test_processes_of_a_team_lose_messages_independently_and_equally_in_every_run():
    lost = {
        (name, seed): set(range(400)) - set(sent(400, name, loss=0.5, disturbance_seed=seed)[0])
        for name in ("robot-0", "robot-1")
        for seed in (0, 1)
    }
    assert lost["robot-0", 0] == set(range(400)) - set(sent(400, loss=0.5)[0])
    # Of 400 messages two that draw apart lose about 100 together, and 15 more or less often.
    keys = list(lost)
    for place, one in enumerate(keys):
        for other in keys[place + 1 :]:
            assert 60 < len(lost[one] & lost[other]) < 140, (one, other)
