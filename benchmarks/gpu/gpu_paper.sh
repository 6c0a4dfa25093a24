#!/usr/bin/env bash
# From a scenes file to AP on one machine with a GPU: renders, trains in pieces, predicts, scores, prints one table.
#
#   benchmarks/gpu/gpu_paper.sh [OUT]          run it again until it says "done": every piece goes on where the last ended
#
# Physics needs PyBullet and 2 MB hold its result, so that the scenes may come from another machine:
#   simgen simulate --object bunny --scenes 2000 -o OUT/train.h5;  simgen simulate ... --seed 1000 -o OUT/test.h5
# They are simulated here where they are not there yet.
#
# Environment: PRESET (paper), DEVICE (cuda), SCENES (2000), VIEWS (17), TEST_SCENES (40), MINUTES of training (60),
# PIECE seconds of training a call (540), BATCH images (32), RATE peak learning rate (1e-4), SENSOR (ideal), DATA (default),
# FIT further options of `posenet fit`. Tried whole without a GPU:
#   PRESET=debug DEVICE=cpu DATA=debug SCENES=8 VIEWS=4 TEST_SCENES=4 MINUTES=0.5 BATCH=4 RATE=2e-3 benchmarks/gpu/gpu_paper.sh
set -euo pipefail
out=${1:-runs/gpu-paper}
preset=${PRESET:-paper} device=${DEVICE:-cuda} data=${DATA:-default} sensor=${SENSOR:-ideal}
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$out"

simulated() { # NAME SEED SCENES VIEWS
    [ -e "$out/$1.h5" ] || simgen simulate --object "${OBJECT:-bunny}" --preset "$data" --seed "$2" --scenes "$3" \
        --views "$4" -o "$out/$1.h5"
    simgen render "$out/$1.h5" --sensor "$sensor" -o "$out/$1"
}
simulated train 0 "${SCENES:-2000}" "${VIEWS:-17}"
simulated test 1000 "${TEST_SCENES:-40}" 2

# SIGINT saves a checkpoint; the same command goes on from there.
ended=0
# shellcheck disable=SC2086
timeout --signal=INT --kill-after=60 "${PIECE:-540}" posenet fit "$out/train" --preset "$preset" --device "$device" \
    --minutes "${MINUTES:-60}" --batch-images "${BATCH:-32}" --learning-rate "${RATE:-1e-4}" ${FIT:-} -o "$out/run" || ended=$?
case $ended in
    0) ;;
    124 | 130) echo "This piece is over; run the same command again to go on." && exit 0 ;;
    *) exit "$ended" ;;
esac

evalkit gt "$out/test" -o "$out/gt.json"
posenet predict "$out/run" "$out/test" --device "$device" -o "$out/alone.json"
posenet predict "$out/run" "$out/test" --device "$device" --refine -o "$out/refined.json"
for kind in alone refined; do evalkit ap "$out/$kind.json" "$out/gt.json" --json "$out/$kind-ap.json"; done
python "$here/training_table.py" "$out" --device "$device"
echo "done"
