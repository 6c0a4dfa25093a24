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

# PyTorch's builds for the CPU take a tenth of the space of those for a GPU: --build-arg PIP_EXTRA_INDEX_URL=… with the
# index of CPU builds that PyTorch's installation page names.
ARG PIP_EXTRA_INDEX_URL=
ENV PIP_EXTRA_INDEX_URL=$PIP_EXTRA_INDEX_URL PIP_NO_CACHE_DIR=1

COPY --chown=binpose:binpose . .
RUN make install REQUIREMENTS=

CMD ["make", "demo"]
