"""What runs beside Blender's main thread: trainings, calibrations, renderings of captures, installations, imports."""
