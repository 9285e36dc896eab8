"""report"""
from pathlib import Path
def write_report(out, calibration, films, views): return Path('a'), Path('b')
