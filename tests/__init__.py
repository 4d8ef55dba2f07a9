"""Facts about the project, and what they are tested with."""
