#!/usr/bin/env bash
# The right arm and hand of a GR-1 humanoid, as Isaac-GR00T publishes it (LeRobot v2.0, 44 joints), become a UR5e with an Inspire hand.
# Usage: examples/08_humanoid_to_arm.sh <folder with gr1_pick_n_place> [target]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
source=${1:?the folder of the dataset, which holds meta/ and data/}
target=${2:-UR5e-Inspire}
export CEI_GYM_EMBODIMENTS=$here/gr1 # robots of one's own: arms/GR1Right.yaml, end_effectors/GR1RightHand.yaml

cei-inspect --dataset.repo_id=nvidia/gr1 --dataset.root="$source" --joint_map="$here/gr1/joint_map.yaml"

# --target_pose: 30 cm to the left of where the humanoid stands, whose right hand rests too near to its own body for another arm.
# --transfer.stretch=1: frames do not repeat, so that the video passes through as it is.
cei-convert --dataset.repo_id=nvidia/gr1 --dataset.root="$source" --joint_map="$here/gr1/joint_map.yaml" \
    --target="$target" --target_pose=0,0.3,0 --new_repo_id=me/gr1 --new_root=outputs/gr1 --transfer.stretch=1 --allow_unreachable

cei-view --dataset.repo_id=me/gr1 --dataset.root=outputs/gr1 --episode=1 \
    --source.repo_id=nvidia/gr1 --source.root="$source" --source.joint_map="$here/gr1/joint_map.yaml" --sheet=outputs/gr1.png
