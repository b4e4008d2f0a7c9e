from imufield.guide.lead.guide_actions import GuideActions
from imufield.guide.lead.state_table import TABLE, Input, State


def test_every_state_has_a_row_and_every_action_exists() -> None:
    assert set(TABLE) == set(State)
    actions = {transition.action for row in TABLE.values() for transition in row.values()}
    assert all(callable(getattr(GuideActions, action)) for action in actions)


def test_every_state_can_be_reached() -> None:
    reached, edge = {State.LEARNING}, [State.LEARNING]
    while edge:
        for transition in TABLE[edge.pop()].values():
            if transition.to not in reached:
                reached.add(transition.to)
                edge.append(transition.to)
    assert reached == set(State)


def test_every_input_is_used_somewhere() -> None:
    assert {happened for row in TABLE.values() for happened in row} == set(Input)


def test_the_operator_can_always_finish_and_a_link_can_always_go() -> None:
    passing = {State.RECOGNISING, State.JUDGING}
    for state in set(State) - passing - {State.DONE}:
        assert TABLE[state][Input.FINISH].to is State.DONE
        if state is not State.LOST:
            assert TABLE[state][Input.LINK_LOST].to is State.LOST
