# docker build -t coldspray .
# docker run --rm -v "$PWD:/data" coldspray run /opt/coldspray/workflows/single_ni.toml
FROM debian:12-slim
RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates make python3 python3-venv && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/coldspray
COPY Makefile ./
RUN make libraries && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home --uid 1000 coldspray && chown coldspray /opt/coldspray && install -d -o coldspray /data
USER coldspray
COPY --chown=coldspray . ./
RUN make setup && rm -rf ~/.cache/uv ~/.cache/pip
WORKDIR /data
ENTRYPOINT ["/opt/coldspray/.venv/bin/coldspray"]
CMD ["--help"]
