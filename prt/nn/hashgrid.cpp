// The lookup of prt/nn/hashgrid.py in one pass: no array of corners, tables read level by level with prefetches.
// Operations and their order are those of the torch version.
#include <memory>

#include "parallel.hpp"

namespace {

constexpr int BLOCK = 64;    // points whose rows are prefetched before any is read
constexpr int GROUP = 4096;  // points that go through one level's table before the next

struct Grid {
  const float *low, *high, *per_unit;
  const int64_t *last_cell;
  const int32_t *factors, *offsets;
  const float *table;
  int levels, features, dense_levels;
  uint32_t mask;
};

struct Corners {
  uint32_t row[8][BLOCK];
  float weight[8][BLOCK];
};

// Products wrap around in 32 bits, as in torch.
template <bool HASHED> void find(const Grid &grid, int level, const float *points, int count, Corners &out) {
  const float per_unit = grid.per_unit[level];
  const uint32_t offset = grid.offsets[level], mask = grid.mask;
  uint32_t factor[3];
  int32_t last[3];
  for (int axis = 0; axis < 3; ++axis) {
    factor[axis] = grid.factors[3 * level + axis];
    last[axis] = (int32_t)grid.last_cell[3 * level + axis];
  }
  for (int i = 0; i < count; ++i) {
    uint32_t near[3];
    float place[3];
    for (int axis = 0; axis < 3; ++axis) {
      const float low = grid.low[axis];
      const float inside = std::min(std::max(points[3 * i + axis], low), grid.high[axis]) - low;
      const float scaled = inside * per_unit;
      const int32_t cell = std::max(0, std::min((int32_t)scaled, last[axis]));  // a NaN reads a row that exists
      place[axis] = scaled - (float)cell;
      near[axis] = (uint32_t)cell * factor[axis];
    }
    for (int c = 0; c < 8; ++c) {
      const uint32_t x = near[0] + (c & 4 ? factor[0] : 0), y = near[1] + (c & 2 ? factor[1] : 0);
      const uint32_t z = near[2] + (c & 1 ? factor[2] : 0);
      out.row[c][i] = offset + (HASHED ? (x ^ y ^ z) & mask : x + y + z);
      out.weight[c][i] = (c & 4 ? place[0] : 1 - place[0]) * (c & 2 ? place[1] : 1 - place[1]) *
                         (c & 1 ? place[2] : 1 - place[2]);
    }
  }
}

// FEATURES 0: any number, known at run time only.
template <int FEATURES> void sum(const Grid &grid, int level, int count, const Corners &corners, float *out) {
  const int features = FEATURES ? FEATURES : grid.features;
  for (int i = 0; i < count; ++i)
    for (int f = 0; f < features; ++f) {
      float total = 0;
      for (int c = 0; c < 8; ++c)
        total += corners.weight[c][i] * grid.table[(int64_t)corners.row[c][i] * features + f];
      out[(int64_t)i * grid.levels * features + level * features + f] = total;
    }
}

void part(const Grid &grid, int level, const float *points, int count, Corners &corners, float *out) {
  if (level < grid.dense_levels)
    find<false>(grid, level, points, count, corners);
  else
    find<true>(grid, level, points, count, corners);
  for (int c = 0; c < 8; ++c)
    for (int i = 0; i < count; ++i)
      __builtin_prefetch(grid.table + (int64_t)corners.row[c][i] * grid.features);
  if (grid.features == 2)
    sum<2>(grid, level, count, corners, out);
  else if (grid.features == 4)
    sum<4>(grid, level, count, corners, out);
  else
    sum<0>(grid, level, count, corners, out);
}

}  // namespace

extern "C" void prt_lookup(const float *points, const float *low, const float *high, const float *per_unit,
                           const int64_t *last_cell, const int32_t *factors, const int32_t *offsets,
                           const float *table, float *out, int64_t count, int levels, int features,
                           int dense_levels, int mask, int threads) {
  const Grid grid{low,     high,  per_unit, last_cell, factors,      offsets,
                  table,   levels, features, dense_levels, (uint32_t)mask};
  const int64_t width = (int64_t)levels * features;
  in_blocks(count, GROUP, threads, [&] {
    auto corners = std::make_shared<Corners>();
    return [&grid, points, out, width, corners](int64_t begin, int size) {
      for (int level = 0; level < grid.levels; ++level)
        for (int64_t start = begin; start < begin + size; start += BLOCK) {
          const int count = (int)std::min<int64_t>(BLOCK, begin + size - start);
          part(grid, level, points + 3 * start, count, *corners, out + width * start);
        }
    };
  });
}
