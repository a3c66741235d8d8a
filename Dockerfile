# gauge-envs with MuJoCo and pictures without a display:
#     docker build --tag gauge-envs .
#     docker run --rm --user "$(id -u)" --volume "$PWD:/work" gauge-envs gauge run SlopeSlider-2-wood --out /work/results
FROM python:3.12-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0 \
    && rm -rf /var/lib/apt/lists/*
ENV MUJOCO_GL=egl
COPY . /src
RUN pip install --no-cache-dir "/src[plot,sanity]" && rm -rf /src
RUN useradd --create-home --uid 1000 gauge
USER gauge
WORKDIR /home/gauge
CMD ["gauge", "--help"]
