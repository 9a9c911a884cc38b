# docker build --tag minitouch-bench .
# The command in an image: PyTorch for the CPU, every optional format, no root.
# BASE: any image of Linux x86-64 with CPython 3.11 to 3.13 and its module venv.
ARG BASE=docker.io/library/python:3.11-slim

FROM ${BASE} AS build
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_CONSTRAINT=/source/constraints.txt
COPY . /source
RUN python3 -m venv /opt/minitouch-bench \
 && /opt/minitouch-bench/bin/pip install --no-deps --index-url ${TORCH_INDEX} torch \
 && /opt/minitouch-bench/bin/pip install '/source[data,hub,onnx,sb3,train,video]'

FROM ${BASE}
COPY --from=build /opt/minitouch-bench /opt/minitouch-bench
# Any user may run it, also one without an entry in passwd: HOME and USER would be asked of there.
ENV PATH=/opt/minitouch-bench/bin:$PATH HOME=/tmp USER=minitouch
USER 1000:1000
WORKDIR /work
ENTRYPOINT ["minitouch-bench"]
