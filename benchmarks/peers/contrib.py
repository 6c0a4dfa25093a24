"""OpenCV's contrib modules, in an environment of their own.

opencv-contrib-python-headless and the opencv-python-headless of this project are two copies of one module, so what
needs contrib is a script that talks through files and runs in a second environment, made when it is first needed.
"""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

REQUIREMENTS = ("opencv-contrib-python-headless>=5.0", "numpy>=1.26")
FOLDER = Path.home() / ".cache" / "binpose" / "opencv-contrib"


def environment(folder: Path = FOLDER) -> Path:
    """The Python of the environment, which is made if it is not there or lacks a module.

    Raises:
        subprocess.CalledProcessError: pip failed.
    """
    python = folder / "bin" / "python"
    check = [str(python), "-c", "import cv2.linemod, cv2.ppf_match_3d"]
    if not python.exists() or subprocess.run(check, capture_output=True).returncode:
        print(f"making {folder} with {REQUIREMENTS[0]}", file=sys.stderr)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "-q", *REQUIREMENTS], check=True)
    return python


def run(script: str, work: Path) -> None:
    """Run a script that lies beside this file on the folder `work`, in the environment.

    Raises:
        subprocess.CalledProcessError: the script failed.
    """
    subprocess.run([environment(), Path(__file__).with_name(script), work], check=True, stdout=sys.stderr)
