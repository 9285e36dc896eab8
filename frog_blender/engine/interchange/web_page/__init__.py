"""A scene as one web page that plays it: ``content`` packs the numbers, ``page`` fills ``page.html`` with the scripts."""
