"""Eight of the arms that ship, of four makers and of six and seven joints, for facts that are slow to check of all."""

EIGHT = ("gen3", "iiwa7", "panda", "ur10", "ur3", "ur5", "ur5e", "xarm6")
