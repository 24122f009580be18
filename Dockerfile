# segloc on slim Debian, without a compiler, as a user without rights:
#   docker build -t segloc .
#   docker run --rm -v "$PWD:/data" segloc localize scan.pcd --map site.segmap
FROM python:3.12-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml CMakeLists.txt README.md LICENSE ./
COPY cpp cpp
COPY src src
RUN python -m venv /opt/segloc && \
    /opt/segloc/bin/pip install --no-cache-dir ".[io,ros,report]" && \
    /opt/segloc/bin/pip uninstall --yes pip

FROM python:3.12-slim
LABEL org.opencontainers.image.title="segloc" \
      org.opencontainers.image.licenses="MIT" \
      org.opencontainers.image.description="Global LiDAR localization in a prior map"
RUN useradd --create-home --uid 1000 segloc
COPY --from=build /opt/segloc /opt/segloc
ENV PATH=/opt/segloc/bin:$PATH PYTHONDONTWRITEBYTECODE=1 MPLCONFIGDIR=/tmp/matplotlib
USER 1000
WORKDIR /data
ENTRYPOINT ["segloc"]
CMD ["--help"]
