"""Raw films or images to cameras: ``pipeline.calibrate`` does all of it, what else is public stands beside.

``views`` and ``sequences`` say what is looked at, ``features`` and ``matching`` what images share. ``structure`` turns
that into a model by ``colmap``, ``checks`` say by ``limits`` whether it is to be used, and ``placing`` does it all in a
process of its own. ``sources`` are what cameras may come from: besides features, a board (``board``, ``board_rig``) and
named points (``points``, with clocks ``clocked_points``), such as a person's joints. ``camera_files`` and ``report``
write what was found.
"""
