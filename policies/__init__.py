"""The LeRobot policy plugin: a small diffusion policy for block pushing whose sampling can be guided."""
