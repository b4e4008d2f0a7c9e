"""Is the unit still or moving? ``detector`` learns the noise floor, ``limits`` follow from it, ``stretch`` compares."""
