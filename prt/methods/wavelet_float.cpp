// The folded network of prt/methods/wavelet_tiles.py in float32 on any processor: blocks of pixels, wavelet after
// wavelet, all activations in the first two caches. Weights come in panels of 32 columns, one after the other.
#include <cstdlib>
#include <cstring>
#include <memory>

#include "parallel.hpp"

namespace {

constexpr int BLOCK = 48;    // pixels whose activations stay in cache
constexpr int PANEL = 32;    // columns of weights that are read together: two vectors
constexpr int COLOURS = 16;  // columns of the last layer: one vector
#ifdef __AVX512F__
constexpr int STEP = 12;  // pixels in registers: 24 of 32 vectors are sums
#else
constexpr int STEP = 3;
#endif

typedef float vec __attribute__((vector_size(64)));

template <int VECTORS> struct Sums {
  vec of[STEP][VECTORS];
  void add(const float *in, int in_row, int depth, const float *weights) {
    for (int d = 0; d < depth; ++d, weights += 16 * VECTORS)
      for (int r = 0; r < STEP; ++r)
        for (int v = 0; v < VECTORS; ++v) of[r][v] += in[r * in_row + d] * ((const vec *)weights)[v];
  }
};

// out = max(bias + in * weights, 0); bias_row: floats between two pixels' biases, 0 where all have the same
void layer(const float *in, int depth, const float *weights, int width, const float *bias, int bias_row, float *out) {
  for (int c = 0; c < width; c += PANEL)
    for (int r = 0; r < BLOCK; r += STEP) {
      Sums<2> sums;
      for (int i = 0; i < STEP; ++i) std::memcpy(sums.of[i], bias + (r + i) * bias_row + c, sizeof sums.of[i]);
      sums.add(in + r * depth, depth, depth, weights + c * depth);
      for (int i = 0; i < STEP; ++i)
        for (int v = 0; v < 2; ++v) {
          const vec value = sums.of[i][v];
          *(vec *)(out + (r + i) * width + c + 16 * v) = value < 0 ? vec{} : value;  // a NaN stays one
        }
    }
}

// sum += in * weights, BLOCK x 16
void last_layer(const float *in, int depth, const float *weights, float *sum) {
  for (int r = 0; r < BLOCK; r += STEP) {
    Sums<1> sums;
    std::memcpy(&sums, sum + r * COLOURS, sizeof sums);
    sums.add(in + r * depth, depth, depth, weights);
    std::memcpy(sum + r * COLOURS, &sums, sizeof sums);
  }
}

struct Workspace {
  float *data, *space, *bias, *z, *y, *sum;
  Workspace(int terms, int width)
      : data((float *)std::aligned_alloc(64, sizeof(float) * BLOCK * (terms + 3 * width + COLOURS))) {
    if (!data) std::abort();
    space = data;
    bias = space + BLOCK * terms;
    z = bias + BLOCK * width;
    y = z + BLOCK * width;
    sum = y + BLOCK * width;
  }
  ~Workspace() { std::free(data); }
  Workspace(const Workspace &) = delete;
};

void copy_rows(const float *from, int columns, int rows, float *to, int to_columns) {
  std::memset(to, 0, sizeof(float) * BLOCK * to_columns);
  for (int r = 0; r < rows; ++r) std::memcpy(to + r * to_columns, from + r * columns, sizeof(float) * columns);
}

}  // namespace

// space (count, terms), bias (count, width). first: panels of (wavelets, padded_terms, padded_width), second: of
// (padded_width, padded_width), last (wavelets, padded_width, 16). out (count, 3), without the constant.
extern "C" void prt_shade(const float *space, const float *bias, const float *first, const float *second,
                          const float *second_bias, const float *last, float *out, int64_t count, int terms, int width,
                          int padded_terms, int padded_width, int wavelets, int threads) {
  in_blocks(count, BLOCK, threads, [&] {
    auto work = std::make_shared<Workspace>(padded_terms, padded_width);
    return [=](int64_t start, int rows) {
      const int inputs = padded_terms, neurons = padded_width;
      copy_rows(space + start * terms, terms, rows, work->space, inputs);
      copy_rows(bias + start * width, width, rows, work->bias, neurons);
      std::memset(work->sum, 0, sizeof(float) * BLOCK * COLOURS);
      for (int k = 0; k < wavelets; ++k) {
        layer(work->space, inputs, first + (int64_t)k * inputs * neurons, neurons, work->bias, neurons, work->z);
        layer(work->z, neurons, second, neurons, second_bias, 0, work->y);
        last_layer(work->y, neurons, last + (int64_t)k * neurons * COLOURS, work->sum);
      }
      for (int r = 0; r < rows; ++r)
        for (int c = 0; c < 3; ++c) out[(start + r) * 3 + c] = work->sum[r * COLOURS + c];
    };
  });
}
