# valvemap, for `docker build .` and docker-compose.yml. Pin the base by digest with
#   --build-arg PYTHON_IMAGE=docker.io/library/python@sha256:...
ARG PYTHON_IMAGE=docker.io/library/python:3.12-slim-bookworm

FROM ${PYTHON_IMAGE} AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_NO_CACHE_DIR=1 \
    PIP_PYTHON=/opt/valvemap/venv/bin/python
WORKDIR /src
RUN python -m venv --without-pip /opt/valvemap/venv
COPY requirements-image.lock requirements-fleet.lock ./
RUN python -m pip install --no-compile --require-hashes --only-binary=:all: -r requirements-image.lock
# With --build-arg FLEET=yes: Kafka and Dask, for `valvemap fleet`.
ARG FLEET=
RUN test -z "$FLEET" || python -m pip install --no-compile --require-hashes --only-binary=:all: -r requirements-fleet.lock
# Tests of others are not run here; warm-up compiles what is imported.
RUN find /opt/valvemap/venv/lib -depth -type d -name tests -exec rm -r {} +
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY service ./service
COPY virtual_rig ./virtual_rig
RUN python -m pip install --no-compile --no-deps .

# Warm-up: what the first start would compile is compiled here, for any machine of this
# architecture; the entry point copies it to where it may be added to.
ENV PATH=/opt/valvemap/venv/bin:$PATH \
    NUMBA_CPU_NAME=generic \
    NUMBA_CACHE_DIR=/opt/valvemap/cache/numba \
    XDG_CACHE_HOME=/opt/valvemap/cache
RUN valvemap warm-up
RUN valvemap rig --offline --duration 1 --record /src/warm-up.csv

FROM ${PYTHON_IMAGE}
LABEL org.opencontainers.image.title="valvemap" \
      org.opencontainers.image.description="Online identification of hydraulic valve flow maps over OPC UA" \
      org.opencontainers.image.licenses="Apache-2.0"
RUN mkdir /data /kafka && chown 10001:10001 /data /kafka
COPY --from=build /opt/valvemap /opt/valvemap
COPY container/healthcheck.py /opt/valvemap/healthcheck.py
ENV PATH=/opt/valvemap/venv/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    HOME=/tmp \
    NUMBA_CPU_NAME=generic \
    NUMBA_CACHE_DIR=/tmp/cache/numba \
    XDG_CACHE_HOME=/tmp/cache \
    VALVEMAP_DATA=/data
WORKDIR /data
VOLUME /data
USER 10001:10001
EXPOSE 4840 4841 8080
STOPSIGNAL SIGINT
HEALTHCHECK --interval=10s --timeout=6s --start-period=60s --retries=3 \
    CMD ["python", "/opt/valvemap/healthcheck.py", "4841"]
ENTRYPOINT ["/bin/sh", "-c", "cp -r /opt/valvemap/cache /tmp/ && exec valvemap \"$@\"", "valvemap"]
CMD ["serve", "--config", "/data/service.toml"]
