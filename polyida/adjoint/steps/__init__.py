"""The steps that a run took, in its frames or taken again."""
