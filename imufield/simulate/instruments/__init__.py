"""How real instruments answer: one scripted behaviour for each family."""
