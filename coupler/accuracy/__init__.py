"""What accuracy costs in time: the ladder of settings, what it taught (bands), how long a run takes here, and its pictures."""
