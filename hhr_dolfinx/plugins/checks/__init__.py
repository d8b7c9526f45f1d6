"""Checks of a scene before anything is factored."""
