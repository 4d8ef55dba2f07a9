"""Paths of poses: whether an arm follows them, where it is lost and why, and from where it would follow them."""
