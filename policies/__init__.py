"""The LeRobot policy plugin: a small diffusion policy for block pushing whose sampling can be guided."""

PLUGIN = "lerobot_policy_guided_push"
"""LeRobot's name of the type that policies are saved with, short `guided_push`: where the plugin was not imported,
LeRobot's error names it."""
