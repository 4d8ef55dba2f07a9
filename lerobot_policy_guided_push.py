"""LeRobot finds this module by the distribution's name and so learns our policy and environments."""
