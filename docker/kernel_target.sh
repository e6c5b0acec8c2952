# Compile numba's kernels for a generation of processors, not for the machine that builds the image: else every other
# machine would compile them again. An x86 processor without AVX2 and FMA compiles its own.
if grep -q '\bavx2\b' /proc/cpuinfo && grep -q '\bfma\b' /proc/cpuinfo; then
  export NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=
fi
