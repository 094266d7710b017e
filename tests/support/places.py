"""Where things are in the checkout."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ROOT / 'ros2_ws' / 'src'
BRINGUP = PACKAGES / 'lpv_bringup'
DATA = ROOT / 'tests' / 'data'
