"""A scene as one web page that plays it: ``content`` packs numbers, ``page`` puts them and the scripts into one file."""
