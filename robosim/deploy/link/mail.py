"""What has arrived by the link, read and checked; what is wrong with the rest is counted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from robosim.deploy.link.lines import Lines
from robosim.deploy.link.messages import MOST_BYTES, AnyMessage, Header, Kind, MessageError, unpack
from robosim.deploy.link.session import Link

_KIND_ON = {
    "clock": Kind.CLOCK,
    "pose": Kind.POSE,
    "body": Kind.BODY,
    "wheels": Kind.COMMAND,
    "deposit": Kind.DEPOSIT,
    "reading": Kind.READING,
    "field": Kind.FIELD,
    "order": Kind.ORDER,
}
"""What is sent on the keys that begin so."""


class Letter(NamedTuple):
    """A sound message."""

    key: str
    header: Header
    message: AnyMessage
    at: float
    """When it arrived, on the monotonic clock, s."""


class Token(NamedTuple):
    """A process that has come or gone."""

    role: str
    """`robot` or `pheromones`."""
    robot: int
    """0 for other roles."""
    instance: int
    there: bool


class Mail:
    """Reads what arrives by a link."""

    def __init__(self, link: Link, lines: Lines, robots: int) -> None:
        self._link = link
        self._lines = lines
        self._robots = robots

    def take(self, timeout: float) -> Iterator[Letter | Token]:
        """Yield what has arrived, in order; waits up to `timeout` s if nothing has."""
        for arrived in self._link.take(timeout):
            try:
                if arrived.data is None:
                    yield self._token(arrived.key, arrived.there)
                    continue
                if arrived.size > MOST_BYTES:
                    raise MessageError("too long")
                header, message = unpack(arrived.data)
                self._check_key(arrived.key, header)
            except MessageError as error:
                self._lines.drop(arrived.key, str(error))
                continue
            yield Letter(arrived.key, header, message, arrived.at)

    def _check_key(self, key: str, header: Header) -> None:
        topic, _, robot = key.partition("/")
        if _KIND_ON.get(topic) is not header.kind:
            raise MessageError("of a kind that does not belong there")
        if robot and robot != str(header.robot):
            raise MessageError("of another robot")
        if header.robot >= self._robots:
            raise MessageError("of a robot that is not in the team")

    def _token(self, key: str, there: bool) -> Token:
        match key.split("/"):
            case ["alive", "robot", robot, instance] if robot.isdecimal() and len(robot) < 5:
                found = Token("robot", int(robot), _instance(instance), there)
            case ["alive", "pheromones", instance]:
                found = Token("pheromones", 0, _instance(instance), there)
            case _:
                raise MessageError("not a token of robosim")
        if found.robot >= self._robots:
            raise MessageError("of a robot that is not in the team")
        return found


def _instance(text: str) -> int:
    try:
        number = int(text, 16)
    except ValueError:
        raise MessageError("not a token of robosim") from None
    if not 0 < number < 2**64:
        raise MessageError("not a token of robosim")
    return number
