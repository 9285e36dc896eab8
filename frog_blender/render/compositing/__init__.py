"""Captures among the user's objects: a scene of captures that follows the user's, laid over it by the compositor."""
