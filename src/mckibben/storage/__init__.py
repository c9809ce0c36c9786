"""Files that survive interruption, and the interruption of long jobs."""
