# syntax=docker/dockerfile:1
# docker build -t warpvox . && docker run --rm -v "$PWD/outputs:/work/outputs" warpvox train task=Walker-v0
# A GPU is for images based on NVIDIA's: --build-arg BASE=nvidia/cuda:... with Python 3.10 or newer.
ARG BASE=python:3.11-slim
FROM ${BASE}
ENV PIP_NO_CACHE_DIR=1 PYTHONUNBUFFERED=1 WARP_CACHE_PATH=/opt/kernels
WORKDIR /opt/warpvox
COPY locks/run.txt constraints.txt ./
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN pip install --no-deps --require-hashes -r run.txt && pip install -c constraints.txt --extra-index-url ${TORCH_INDEX} torch
COPY . .
RUN pip install --no-deps .
WORKDIR /work
# Kernels are compiled ahead: for one robot, batches, batches of different bodies, and exact arithmetic.
RUN python <<EOF && chmod -R a+rwX ${WARP_CACHE_PATH}
import warpvox as wv
for num_envs in 1, 8, 16, 512:
    for designs in ["walker"], ["walker", "worm"][:num_envs]:
        for dtype in "float32", "float64":
            env = wv.make_vec("Walker-v0", designs=designs, num_envs=num_envs, dtype=dtype, device="cpu")
            env.step(env.reset()[0].new_ones(num_envs, env.num_actions))
EOF
ENTRYPOINT ["warpvox"]
CMD ["--help"]
