"""What the page is given to draw and to say, beside what the terminal draws."""

from __future__ import annotations

import json
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the page needs websockets")

from imufield.guide.view.sound import Cue
from tests.web.guide_stages import WARMTH_DEGC, StagedSession


def whole(staged: StagedSession) -> dict[str, Any]:
    """Return what a page that comes is given."""
    _, message = staged.page.board.wait(-1, 0.0)
    assert message is not None
    found: dict[str, Any] = json.loads(message)
    return found


# Seven positions of a session: accuracy begins with the fourth, numbers of it later.
def test_what_a_page_is_given() -> None:
    staged = StagedSession()
    assert "rejected" in iter(staged.stages())
    given = whole(staged)

    assert {len(block) for block in given["trace"]} == {8}
    assert given["trace"][-1][7] == WARMTH_DEGC
    assert given["state"]["stillness"]["words"]

    done, *accuracies = zip(*given["map"]["forecasts"], strict=True)
    assert list(done) == sorted(set(done))
    assert all(any(value is not None for value in values) for values in zip(*accuracies, strict=True))
    assert done[-1] == given["state"]["done"] == 7
    assert len(accuracies) == len(given["state"]["known"])

    # As the terminal sounds and speaks; what is only heard has no line.
    last = given["log"][-1]
    assert (last["kind"], last["tones"], last["spoken"]) == (
        "rejected",
        [list(tone) for tone in Cue.REFUSED.tones],
        "moved, again",
    )
    moves = [line for line in given["log"] if line["kind"] == "move"]
    assert all(not line["text"] and line["spoken"].startswith("next: ") for line in moves)
    assert len(moves) > 7

    # Accuracy that was undone is forgotten.
    staged.mark("undo")
    given = whole(staged)
    assert given["state"]["done"] == 6
    assert given["map"]["forecasts"][-1][0] <= 6
