"""Local web page: identification, design of a joint, and runs. Needs the extra `web`."""
