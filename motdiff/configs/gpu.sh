#!/usr/bin/env bash
# From sharp photos and a gyroscope recording to exported weights in 25 minutes of one GPU.
#   bash motdiff/configs/gpu.sh PHOTOS GYRO OUT           # PHOTOS: a folder, or a pack of python -m motdiff pack
#   CALLS=1 bash motdiff/configs/gpu.sh PHOTOS GYRO OUT   # trains one of the three pieces, of MINUTES=7.2 each
#   bash motdiff/configs/gpu.sh --rehearse                # all of it on a CPU, tiny, with photos of scikit-image
# OUT gets photos.zip, run.toml, run/ (checkpoint, log.csv, progress.png) and weights.safetensors. What is there already
# is not made again: stopped, or with steps left, the same command goes on.
set -euo pipefail
trap 'exit 130' INT TERM # the training ends with a checkpoint, and this script after it

configs=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=${configs%/motdiff/configs}
python=python3
if [[ -x $root/.venv/bin/python ]]; then python=$root/.venv/bin/python; fi
export PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH}
pieces=3
minutes=${MINUTES:-7.2}
calls=${CALLS:-$pieces}
most_photos=40000000 # bytes
most_weights=16000000
device=cuda
first=2    # minutes of the first updates, which show the speed
every=1    # minutes between validations
changes=() # of gpu.toml

motdiff() { "$python" -m motdiff "$@"; }
fail() {
    echo "error: $1" >&2
    exit 2
}

if [[ ${1:-} == --rehearse && $# -le 2 ]]; then
    out=${2:-$(mktemp -d)}
    photos=$out/photos
    gyro=$out/shakes.csv
    minutes=${MINUTES:-0.3}
    device=cpu
    first=0.2
    every=0.1
    most_weights=3000000
    changes=(
        -e 's/^motions = .*/motions = 16\
held_out = 3\
validation = 2/'
        -e 's/^physics_width = .*/physics_width = 8/'
        -e 's/^denoiser_width = .*/denoiser_width = 8/'
        -e 's/^batch = .*/batch = 2/'
    )
    export OMP_NUM_THREADS=1 # the arrays are small: where cores are busy, more threads are far slower
    mkdir -p "$photos"
    "$python" - "$photos" "$gyro" <<'EOF'
import sys

import cv2
import numpy as np
from skimage import data

photos, gyro = sys.argv[1:]
for photo in (data.astronaut, data.coffee, data.rocket):
    cv2.imwrite(f"{photos}/{photo.__name__}.png", photo()[..., ::-1])
walk = np.cumsum(np.random.default_rng(0).standard_normal((3000, 3)), axis=0)
table = np.column_stack([np.arange(3000) / 200, 0.01 * (walk - walk.mean(axis=0))])
np.savetxt(gyro, table, delimiter=",", header="t_s,x,y,z", comments="")
EOF
elif [[ $# -eq 3 ]]; then
    photos=$1
    gyro=$2
    out=$3
else
    fail "wanted PHOTOS GYRO OUT, or --rehearse [OUT]"
fi

number='^[0-9]+([.][0-9]+)?$'
[[ $minutes =~ $number ]] || fail "MINUTES: must be a number, got '$minutes'"
[[ $calls =~ ^[0-9]+$ ]] || fail "CALLS: must be a whole number, got '$calls'"
[[ -f $gyro ]] || fail "$gyro: must be a file, a gyroscope recording"
mkdir -p "$out"
cp "$gyro" "$out/gyro.txt"
if [[ ! -e $out/photos.zip ]]; then motdiff pack "$photos" "$out/photos.zip" --side 400 --quality 88; fi
bytes=$(($(wc -c <"$out/photos.zip")))
if ((bytes > most_photos)); then
    rm "$out/photos.zip"
    fail "$photos: must have at most $most_photos bytes when packed, has $bytes; take fewer photos"
fi
cd "$out" # the paths in gpu.toml are relative

train() { motdiff train "$1" -o run --device "$device" --minutes "$2" --validate-minutes "$every"; }
in_checkpoint() {
    "$python" -c "from motdiff.weights_io import read_card; run = read_card('run/checkpoint', 'motdiff.checkpoint/2'); print($1)"
}
if [[ ! -e run.toml ]]; then
    sed -e '' ${changes[@]+"${changes[@]}"} "$configs/gpu.toml" >first.toml
    train first.toml "$first"
    # the rate comes down when the time is over, of which a tenth goes into reading photos and validating
    steps=$(in_checkpoint "run['step'] + round(0.9 * $pieces * 60 * $minutes * run['step'] / run['seconds'])")
    sed "s/^steps = .*/steps = $steps/" first.toml >run.toml.new
    mv run.toml.new run.toml
    rm first.toml
fi
steps=$(sed -n 's/^steps = //p' run.toml)
for ((call = 0; call < calls; call++)); do
    if (($(in_checkpoint "run['step']") >= steps)); then break; fi
    train run.toml "$minutes"
done

if [[ ! weights.safetensors -nt run/checkpoint ]]; then
    rm -f weights.safetensors*
    motdiff export run -o weights.safetensors --offset 1.8 # log(path_weight + 1)
    if (($(wc -c <weights.safetensors) > most_weights)); then # joined again by cat
        split -b "$most_weights" weights.safetensors weights.safetensors.
    fi
fi
echo "$out: step $(in_checkpoint "run['step']") of $steps; $(echo weights.safetensors*)"
