"""The guide itself: state table, actions, what it says, plan, holds, turns and advice."""
