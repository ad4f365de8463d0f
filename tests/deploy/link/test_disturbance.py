"""A link that is bad on purpose."""

import threading
import time

from robosim.deploy.link.disturbance import Disturbance, Disturber


def sent(count, **what):
    """Send numbers through a disturber; return what has come out, in order, and when."""
    came, enough = [], threading.Event()
    disturber = Disturber(
        Disturbance(**what), lambda key, data: came.append((int(data), time.monotonic())) or enough.set()
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
