# docker build -t sixthsense .
# docker run --rm -v "$PWD/runs:/work/runs" sixthsense run apartment
# Files of the host that the user of the image cannot write: add --user "$(id -u):$(id -g)".
FROM python:3.12-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY sixthsense sixthsense
COPY scenes scenes
RUN python -m venv /opt/venv && /opt/venv/bin/pip install --no-cache-dir .

# docker build --target interop -t sixthsense-interop . && docker run --rm sixthsense-interop
# Live runs with a robot on Fast DDS, as ROS 2 speaks it; of Debian 12, whose Fast DDS is 2.9.
FROM python:3.12-slim-bookworm AS interop
RUN apt-get update && apt-get install -y --no-install-recommends \
    default-jre-headless fastddsgen g++ libfastrtps-dev make && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY . .
CMD ["make", "interop"]

FROM python:3.12-slim
COPY --from=build /opt/venv /opt/venv
ENV PATH=/opt/venv/bin:$PATH \
    NUMBA_CACHE_DIR=/var/cache/sixthsense/numba \
    MPLCONFIGDIR=/var/cache/sixthsense/matplotlib \
    MPLBACKEND=agg \
    PYTHONUNBUFFERED=1
# The kernels are compiled here, once; any user of the image may add to them.
RUN useradd --create-home --uid 1000 robot \
    && mkdir -p /var/cache/sixthsense /work/runs \
    && python -c "from sixthsense.running.warmup import warm_up; warm_up(); warm_up('scan-matching')" \
    && chmod -R a+rwX /var/cache/sixthsense \
    && chown -R robot /work
USER robot
WORKDIR /work
VOLUME /work/runs
ENTRYPOINT ["sixthsense"]
CMD ["--help"]
