#!/bin/sh
# Nine trainings, three tasks with three seeds, as jobs of SLURM: sh slurm_sweep.sh [KEY=VALUE ...]
# Needs Hydra's launcher: pip install hydra-submitit-launcher. submitit_local makes the same runs on this machine.
set -e
warpvox train -m "task=Walker-v0,Carrier-v0,UpStepper-v0" "seed=0,1,2" design=auto name=sweep \
    hydra/launcher=submitit_slurm hydra.launcher.partition=cpu hydra.launcher.cpus_per_task=4 \
    hydra.launcher.mem_gb=8 hydra.launcher.timeout_min=120 threads=4 device=cpu "$@"
warpvox curves 'runs=outputs/train/*/*_sweep*' # when all jobs are done
