# The demo in a container, without root and without a GPU:
#
#   docker build -t binpose .
#   docker run --name binpose binpose                  # a quarter of an hour on 2 cores
#   docker cp binpose:/home/binpose/binpose/demo .     # pictures, model and scores
#
# and any other command: docker run --rm binpose .venv/bin/simgen --help
FROM python:3.12-slim

# Unpinned, for Debian keeps no old versions.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends make \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 1000 --create-home binpose
USER 1000
WORKDIR /home/binpose/binpose

# PyTorch's builds for the CPU take a tenth of the space; for a GPU: --build-arg TORCH_INDEX=https://pypi.org/simple
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ENV PIP_EXTRA_INDEX_URL=$TORCH_INDEX PIP_NO_CACHE_DIR=1

COPY --chown=binpose:binpose . .
RUN make install REQUIREMENTS=

CMD ["make", "demo"]
