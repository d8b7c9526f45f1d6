# Runs the demos and the tests as an ordinary user; the steps are those of the README.
#   docker build -t hhr_dolfinx .
#   docker run --rm -v "$PWD/out:/home/hhr/hhr_dolfinx/out" hhr_dolfinx
FROM debian:trixie-slim
RUN apt-get update \
 && apt-get install -y --no-install-recommends ca-certificates make gcc libc6-dev python3 python3-dev python3-venv \
    libegl1 libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1 \
 && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home hhr
USER hhr
WORKDIR /home/hhr/hhr_dolfinx
COPY --chown=hhr:hhr . .
ENV PIP_NO_CACHE_DIR=1 OMP_NUM_THREADS=1 PATH="/home/hhr/hhr_dolfinx/.venv/bin:$PATH"
RUN make setup
CMD ["make", "demo"]
