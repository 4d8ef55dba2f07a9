"""What the numbers of a task are, and what its actions do to the flange: plain data below environments and policies."""
