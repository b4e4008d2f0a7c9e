"""The real commands on 2000 hostile files and 200 hostile links: all with ``TORTURE=full``, else some of every kind.

Whatever they read: no traceback, no hang, a documented exit code with one sentence, at most 10 s and 500 MiB, nothing written
or read outside of the working folder, no control character that imufield did not write.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.torture.conftest import FULL, Campaign
from tests.torture.second_checks import meet_file, meet_link
from tests.torture.second_corpus import FILES, hostile_file
from tests.torture.second_links import hostile_link
from tests.torture.second_sound import Sound

LINKS = 200
PARTS = 40 if FULL else 1
EVERY = 50
"""Which of the files CI takes, each fiftieth; and which of the links."""
EVERY_LINK = 33
CAME = "no traceback, no hang, one sentence, nothing read or written outside, no control character on the terminal"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    return Sound(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize("part", range(PARTS))
def test_files(part: int, sound: Sound, tmp_path: Path, campaign: Campaign) -> None:
    numbers = range(part, len(FILES), PARTS if FULL else EVERY)
    findings: list[str] = []
    for number in numbers:
        hostile = hostile_file(sound, number)
        found = meet_file(hostile, tmp_path / str(number), on_terminal=number % 2 == 1)
        findings += [f"file {number}, {hostile.name} ({' '.join(hostile.command)}): {each}" for each in found]
    assert not findings, "\n".join(findings)
    campaign.tell("hostile files of a second corpus, read by every command that reads files", len(numbers), "files", CAME)


@pytest.mark.parametrize("part", range(PARTS))
def test_links(part: int, tmp_path: Path, campaign: Campaign) -> None:
    numbers = range(part, LINKS, PARTS if FULL else EVERY_LINK)
    findings: list[str] = []
    for number in numbers:
        hostile = hostile_link(number)
        found = meet_link(hostile, tmp_path / str(number), on_terminal=number % 2 == 1)
        findings += [f"link {number}, {hostile.name} ({' '.join(hostile.command)}): {each}" for each in found]
    assert not findings, "\n".join(findings)
    campaign.tell(
        "hostile instruments on serial ports, TCP and CAN, and what was recorded of them", len(numbers), "links", CAME
    )
