"""Reachability maps, their similarity, and the energy field made from it."""
