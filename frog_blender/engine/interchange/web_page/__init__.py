"""A scene as one web page that plays it: ``content`` packs numbers, ``page`` writes them and the scripts to a file."""
