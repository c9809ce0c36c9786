"""The same knee, valves and loops in other people's tools, and in C: what ours is measured against."""
