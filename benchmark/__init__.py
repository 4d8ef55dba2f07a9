"""The commands: maps, demonstrations, training, rollouts, tables."""
