"""The guide itself: state table, actions, what it says, plan (positions, and how near a hold must be), holds, turns, advice."""
