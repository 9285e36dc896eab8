"""Files that anybody may have written: read with their sizes checked, written whole or not at all."""
