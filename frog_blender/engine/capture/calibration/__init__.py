"""Raw films or images to cameras: ``pipeline.calibrate`` does all of it, by the first source that leads there.

``views`` and ``sequences`` say what is looked at, ``features`` what images share. ``structure`` turns that into a model
by ``colmap``, ``checks`` say by ``limits`` whether it is to be used, and ``placing`` does it all in a process of its
own. Another source is a board (``board``).
``camera_files`` and ``report`` write what was found.
"""
