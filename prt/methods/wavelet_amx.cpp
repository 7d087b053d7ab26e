// The folded network of prt/methods/wavelet_tiles.py on the matrix unit of x86 processors (AMX, bfloat16): 32 pixels
// at a time, wavelet after wavelet, all activations in the first two caches.
//
// Weights come as tiles of 32 x 16 numbers in the order the matrix unit reads them: row r holds the pairs of rows
// 2 r and 2 r + 1 of 16 columns.
#include <immintrin.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <memory>

#include "parallel.hpp"

namespace {

using bfloat = uint16_t;
constexpr int ROWS = 32;     // pixels of a block: two tiles
constexpr int WEIGHTS = 512;  // numbers of a tile of weights
constexpr int COLOURS = 16;

struct alignas(64) TileConfig {
  uint8_t palette = 1, start = 0, reserved[14] = {};
  uint16_t bytes[16] = {64, 64, 64, 64, 64, 64, 64, 64};
  uint8_t rows[16] = {16, 16, 16, 16, 16, 16, 16, 16};
};

template <class T> struct Buffer {
  T *data;
  explicit Buffer(size_t count) : data((T *)std::aligned_alloc(64, (count * sizeof(T) + 63) / 64 * 64)) {
    if (!data) std::abort();
  }
  ~Buffer() { std::free(data); }
  Buffer(const Buffer &) = delete;
};

// max(from, 0), 32 x 32 numbers, rounded to bfloat16
inline void rectify(const float *from, bfloat *to, int to_row) {
  const __m512 zero = _mm512_setzero_ps();
  for (int r = 0; r < ROWS; ++r, from += 32, to += to_row) {
    // (zero, value): a NaN stays one
    const __m512 low = _mm512_max_ps(zero, _mm512_load_ps(from));
    const __m512 high = _mm512_max_ps(zero, _mm512_load_ps(from + 16));
    _mm512_store_si512((__m512i *)to, (__m512i)_mm512_cvtne2ps_pbh(high, low));
  }
}

// out = max(bias + in * weights, 0). depth: tiles of 32 inputs; bias_row: floats between two pixels' biases, 0 where
// all have the same.
inline void layer(const bfloat *in, int depth, const bfloat *weights, int width, const float *bias, int bias_row,
                  bfloat *out, float *scratch) {
  const int in_row = depth * 32, tiles = width / 16;
  for (int t = 0; t < tiles; t += 2) {
    const float *start = bias + 16 * t;
    _tile_loadd(0, start, 4 * bias_row);
    _tile_loadd(1, start + 16, 4 * bias_row);
    _tile_loadd(2, start + 16 * bias_row, 4 * bias_row);
    _tile_loadd(3, start + 16 * bias_row + 16, 4 * bias_row);
    for (int d = 0; d < depth; ++d) {
      const bfloat *w = weights + (d * tiles + t) * WEIGHTS;
      _tile_loadd(4, in + 32 * d, 2 * in_row);
      _tile_loadd(6, w, 64);
      _tile_dpbf16ps(0, 4, 6);
      _tile_loadd(7, w + WEIGHTS, 64);
      _tile_dpbf16ps(1, 4, 7);
      _tile_loadd(5, in + 32 * d + 16 * in_row, 2 * in_row);
      _tile_dpbf16ps(2, 5, 6);
      _tile_dpbf16ps(3, 5, 7);
    }
    // two scratches in turn: the next tiles need not wait until this one is read
    float *s = scratch + (t & 2) * 512;
    _tile_stored(0, s, 128);
    _tile_stored(1, s + 16, 128);
    _tile_stored(2, s + 512, 128);
    _tile_stored(3, s + 512 + 16, 128);
    rectify(s, out + 16 * t, width);
  }
}

// sum += in * weights, 32 x 16
inline void last_layer(const bfloat *in, int depth, const bfloat *weights, float *sum) {
  const int in_row = depth * 32;
  _tile_loadd(0, sum, 64);
  _tile_loadd(1, sum + 16 * COLOURS, 64);
  for (int d = 0; d < depth; ++d) {
    _tile_loadd(6, weights + d * WEIGHTS, 64);
    _tile_loadd(4, in + 32 * d, 2 * in_row);
    _tile_dpbf16ps(0, 4, 6);
    _tile_loadd(5, in + 32 * d + 16 * in_row, 2 * in_row);
    _tile_dpbf16ps(1, 5, 6);
  }
  _tile_stored(0, sum, 64);
  _tile_stored(1, sum + 16 * COLOURS, 64);
}

inline bfloat rounded(float value) {
  if (value != value) return 0x7FC0;  // adding to a NaN's bits could make it a number
  uint32_t bits;
  std::memcpy(&bits, &value, 4);
  return (bfloat)((bits + 0x7FFF + ((bits >> 16) & 1)) >> 16);
}

struct Workspace {
  Buffer<bfloat> space, z, y;
  Buffer<float> bias, scratch, sum;
  Workspace(int terms, int width)
      : space(ROWS * terms), z(ROWS * width), y(ROWS * width), bias(ROWS * width), scratch(2 * ROWS * 32),
        sum(ROWS * COLOURS) {
    const TileConfig config;
    _tile_loadconfig(&config);
  }
  ~Workspace() { _tile_release(); }
};

}  // namespace

// Whether the system lets this process use the matrix unit; it has to be asked once.
extern "C" int prt_amx_allowed() { return syscall(SYS_arch_prctl, 0x1023 /* ARCH_REQ_XCOMP_PERM */, 18) == 0; }

// space (count, terms), bias (count, width): float32. first: tiles of (wavelets, padded_terms, padded_width), second:
// of (padded_width, padded_width), last: of (wavelets, padded_width, 16). out (count, 3), without the constant.
extern "C" void prt_shade(const float *space, const float *bias, const bfloat *first, const bfloat *second,
                          const float *second_bias, const bfloat *last, float *out, int64_t count, int terms,
                          int width, int padded_terms, int padded_width, int wavelets, int threads) {
  in_blocks(count, ROWS, threads, [&] {
    auto work = std::make_shared<Workspace>(padded_terms, padded_width);
    return [=](int64_t start, int rows) {
      const int inputs = padded_terms, neurons = padded_width;
      bfloat *s = work->space.data;
      float *g = work->bias.data, *sum = work->sum.data;
      std::memset(s, 0, ROWS * inputs * sizeof(bfloat));
      std::memset(g, 0, ROWS * neurons * sizeof(float));
      std::memset(sum, 0, ROWS * COLOURS * sizeof(float));
      for (int r = 0; r < rows; ++r) {
        for (int m = 0; m < terms; ++m) s[r * inputs + m] = rounded(space[(start + r) * terms + m]);
        std::memcpy(g + r * neurons, bias + (start + r) * width, width * sizeof(float));
      }
      for (int k = 0; k < wavelets; ++k) {
        const bfloat *own = first + (int64_t)k * inputs * neurons;
        layer(s, inputs / 32, own, neurons, g, neurons, work->z.data, work->scratch.data);
        layer(work->z.data, neurons / 32, second, neurons, second_bias, 0, work->y.data, work->scratch.data);
        last_layer(work->y.data, neurons / 32, last + (int64_t)k * neurons * COLOURS, sum);
      }
      for (int r = 0; r < rows; ++r)
        for (int c = 0; c < 3; ++c) out[(start + r) * 3 + c] = sum[r * COLOURS + c];
    };
  });
}
