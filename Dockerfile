# The demo in a container, without root and without a GPU:
#
#   docker build -t binpose .
#   docker run --name binpose binpose                  # a quarter of an hour on 2 cores
#   docker cp binpose:/home/binpose/binpose/demo .     # pictures, model and scores
#
# and any other command: docker run --rm binpose .venv/bin/simgen --help
# Of another Python from 3.10 to 3.13: --build-arg PYTHON=3.11
ARG PYTHON=3.12
FROM python:${PYTHON}-slim

# Unpinned, for Debian keeps no old versions.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends make \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 1000 --create-home binpose
USER 1000
WORKDIR /home/binpose/binpose

# The image takes 6.5 GB with PyTorch's builds for a GPU, which PyPI has, and 2.5 GB with those for the CPU:
# --build-arg PIP_EXTRA_INDEX_URL=… with the index of CPU builds that PyTorch's installation page names.
ARG PIP_EXTRA_INDEX_URL=
ENV PIP_EXTRA_INDEX_URL=$PIP_EXTRA_INDEX_URL PIP_NO_CACHE_DIR=1

COPY --chown=binpose:binpose . .
RUN make install REQUIREMENTS=

CMD ["make", "demo"]
