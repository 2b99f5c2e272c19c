"""What is left of a run: the result, its folder, its report and its pictures."""
