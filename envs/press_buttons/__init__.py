"""Press any two of four buttons that face in all directions, with the tip of a rod."""
