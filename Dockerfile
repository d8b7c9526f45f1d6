# Runs the demos and the tests as an ordinary user, whichever: the steps are those of the README.
#   docker build -t hhr_dolfinx .
#   mkdir -p out
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD/out:/home/hhr/hhr_dolfinx/out" hhr_dolfinx
# Without mkdir Docker makes `out` itself, as root, and nobody else could write to it.
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
# readable by all, whatever the rights in the checkout
RUN chmod -R a+rX . && make setup
# A user known by number only has no home; compiled forms (DOLFINx), loops (numba) and fonts (matplotlib) are kept in
# one place where anybody may write. The folder of the project is open for out/ and what pytest leaves behind.
ENV HOME=/home/hhr XDG_CACHE_HOME=/home/hhr/cache NUMBA_CACHE_DIR=/home/hhr/cache/numba \
    MPLCONFIGDIR=/home/hhr/cache/matplotlib
RUN mkdir -p out && rm -rf "$XDG_CACHE_HOME" /home/hhr/.cache /home/hhr/.config \
 && mkdir -p "$NUMBA_CACHE_DIR" "$MPLCONFIGDIR" "$XDG_CACHE_HOME" \
 && chmod 1777 /home/hhr . out "$XDG_CACHE_HOME" "$NUMBA_CACHE_DIR" "$MPLCONFIGDIR"
CMD ["make", "demo"]
