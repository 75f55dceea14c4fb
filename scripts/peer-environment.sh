#!/bin/sh
# A virtual environment of its own with the libraries that exported datasets are made for, for the round trips in
# tests/test_export.py: LeRobot, robomimic and Minari. Their pins disagree with this project's and with each other, so that
# LeRobot and robomimic are installed without their dependencies, beside what reading a dataset takes.
# Usage: scripts/peer-environment.sh [folder]   (default: .peers; the tests look there, or where ACGD_PEERS says)
set -eu
folder=${1:-.peers}
"${PYTHON:-python3.11}" -m venv "$folder"
pip="$folder/bin/python -m pip install --quiet --disable-pip-version-check"
$pip torch==2.13.0
$pip torchvision==0.28.0 "datasets>=4,<5" "accelerate<2" "av>=15,<16" jsonlines==4.0.0 packaging termcolor tqdm \
    numpy==2.4.6 pandas pyarrow==25.0.1 h5py==3.16.0 pillow gymnasium==1.2.3 imageio psutil
$pip --no-deps lerobot==0.4.4 minari==0.5.4 robomimic==0.3.0
$pip typer typing_extensions six matplotlib
echo "$folder"
