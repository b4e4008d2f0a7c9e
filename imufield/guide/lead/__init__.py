"""The guide itself: state table, actions, plan, turns, refusals and advice."""
