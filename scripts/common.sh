# Sourced by the other scripts: sets `root`, enters it (`called_from` is the former folder), and has the common build steps.
# shellcheck shell=bash
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# shellcheck disable=SC2034
called_from=$PWD
cd "$root" || exit 1

# Compilers of PCL's headers take up to 2 GB each.
parallel_jobs() {
  local processors memory_gb
  processors=$(nproc)
  memory_gb=$(awk '/^MemAvailable:/ {print int($2 / 2097152)}' /proc/meminfo 2>/dev/null || echo "$processors")
  ((memory_gb < 1)) && memory_gb=1
  echo $((processors < memory_gb ? processors : memory_gb))
}

# configure PRESET [cmake arguments...]: into build/PRESET, with ccache if it is installed.
configure() {
  local preset=$1
  shift
  local launcher=()
  command -v ccache >/dev/null && launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
  cmake --preset "$preset" "${launcher[@]}" "$@"
}

# The version of project() in CMakeLists.txt, the only place that states it.
project_version() {
  sed -n 's/^project(loopwise VERSION \([0-9.]*\).*/\1/p' "$root/CMakeLists.txt"
}
