"""Studies with people: a study file, its trials, what was answered, and the statistics of it."""
