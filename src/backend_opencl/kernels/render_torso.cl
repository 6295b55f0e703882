/* SPDX-License-Identifier: MIT
 * Draws the torso over a picture in one kernel: choice of pixels, deformation, grid, network and compositing.
 *
 * The inputs of a first layer are encodings of a pixel's row and column. What each row and each column contributes is
 * computed once, so that a pixel needs only the sum of two terms. A segment is WIDTH pixels of a row. An item takes
 * patches of the picture from a shared counter and goes through their rows. A tile (tile.cl) is VECTORS segments with a
 * pixel whose occupancy is above the threshold.
 *
 * Built with LEVELS; AT_x: where in `net` matrix x begins; ROW_x: where in a tile x begins, TILE_ROWS its rows; and
 * GROUP, VECTORS, OUTPUTS. */
#define HIDDEN 32
#define TERMS (2 * HIDDEN) /* units of the first layers: the deformation's, then the network's */
#define OCTAVES 8
#define ENCODED (1 + 2 * OCTAVES) /* values of one coordinate: itself, then sine and cosine by octave */
#define Q_ROWS (2 * ENCODED)
#define CELLS 128
#define CONTROL 16 /* rows and columns of control points */
#define INTW(x) JOINW(convert_int)(x)
#define PATCH (WIDTH == 1 ? 1 : 32) /* rows of a patch, which is WIDTH pixels wide */

/* Parameters of a frame; the same struct as in render_torso.c. */
struct torso_frame {
  int width, height;
  float threshold, shrink;
  uint across, patches; /* patches in a row of them, and in all */
};

struct torso_level { /* entry (row, column) = (row + column*step) & mask, of two values each */
  float scale;       /* position = u*scale + 0.5 */
  uint step, mask, at;
};

/* Where the parameters hold the first layers. at: start of unit 0's inputs [q, k, code]; step: from one unit to the
 * next. */
struct first_layers {
  ulong at[2], step[2];
};

/* 2i/(side - 1) - 1; a side of one pixel is at 0. */
#define COORDINATE(real, i, side) ((side) > 1 ? (i) / (float)((side)-1) : (real)(0))

/* ---- once a frame: the first layers ---- */

/* bias_j = what the pose and the individual code contribute to unit j. */
kernel void torso_bias(SPAN(float, bias), SPAN(const float, parameters), SPAN(const float, pose),
                       SPAN(const float, code), uint pose_rows, uint code_rows, const struct first_layers first) {
  OPEN(float, bias);
  OPEN(const float, parameters);
  OPEN(const float, pose);
  OPEN(const float, code);
  const uint j = get_global_id(0), net = j / HIDDEN;
  if (j >= TERMS) return;
  global const float *w = parameters + first.at[net] + j % HIDDEN * first.step[net] + Q_ROWS;
  float sum = 0;
  for (uint i = 0; i < pose_rows; i++) sum += w[i] * pose[i];
  for (uint i = 0; i < code_rows; i++) sum += w[pose_rows + i] * code[i];
  bias[j] = sum;
}

/* rows [height][TERMS], columns [TERMS][padded]; the bias is added to columns. Item i computes row i, or column i -
 * height where i >= height. */
kernel void torso_terms(SPAN(float, rows), SPAN(float, columns), SPAN(const float, bias), SPAN(const float, parameters),
                        const struct torso_frame frame, uint padded, const struct first_layers first) {
#pragma OPENCL FP_CONTRACT OFF
  OPEN(float, rows);
  OPEN(float, columns);
  OPEN(const float, bias);
  OPEN(const float, parameters);
  const int item = get_global_id(0), d = item >= frame.height, i = d ? item - frame.height : item;
  const int side = d ? frame.width : frame.height;
  float value[ENCODED];
  if (item >= frame.height + (int)padded) return;
  value[0] = frame.shrink * COORDINATE(float, (float)(2 * i - (side - 1)), side);
  for (int o = 0; o < OCTAVES; o++) {
    const float x = (float)(1 << o) * value[0];
    value[1 + 2 * o] = sin(x);
    value[2 + 2 * o] = sin(x + 1.57079632679489661923f);
  }
  for (uint j = 0; j < TERMS; j++) {
    global const float *w = parameters + first.at[j / HIDDEN] + j % HIDDEN * first.step[j / HIDDEN] + d;
    float sum = d ? bias[j] : 0;
    for (int c = 0; c < ENCODED; c++) sum += w[2 * c] * value[c];
    if (d)
      columns[j * padded + i] = sum;
    else
      rows[i * TERMS + j] = sum;
  }
}

/* ---- a tile ---- */

struct segment { /* WIDTH pixels of a row */
  int row, column;
  intw chosen;
};

/* Pixels of a segment where the occupancy, bilinear with aligned corners, is above the threshold (torso_ref.c). */
INLINE intw choose(const struct torso_frame *f, global const float *grid, int row, int column) {
#pragma OPENCL FP_CONTRACT OFF
  const intw i = column + INTW(lane_numbers());
  const float y = COORDINATE(float, (float)(2 * row - (f->height - 1)), f->height);
  const floatw x = COORDINATE(floatw, REAL(2 * i - (f->width - 1)), f->width);
  const float r = (y + 1) / 2 * (CELLS - 1);
  const floatw c = (x + 1) / 2 * (CELLS - 1);
  const int r0 = min((int)r, CELLS - 2);
  const intw inside = i < f->width, c0 = select((intw)(0), min(INTW(c), CELLS - 2), inside);
  const float lower = r - (float)r0;
  const floatw later = c - REAL(c0);
  const intw at = c0 * CELLS + r0, next = at + CELLS, at1 = at + 1, next1 = next + 1;
  const floatw left = (1 - lower) * GATHER(floatw, grid, at) + lower * GATHER(floatw, grid, at1);
  const floatw right = (1 - lower) * GATHER(floatw, grid, next) + lower * GATHER(floatw, grid, next1);
  return inside & ((1 - later) * left + later * right > f->threshold);
}

/* Features of a tile at u on [0, 1]; zeros where `outside`. */
INLINE void encode(local floatw *tile, floatw u[2][VECTORS], intw outside[VECTORS],
                   global const struct torso_level *level, global const float *table) {
#pragma OPENCL FP_CONTRACT OFF
  for (int l = 0; l < LEVELS; l++) {
    const struct torso_level of = level[l];
    global const float *value = table + of.at;
    uintw entry[VECTORS][4]; /* twice the entry's number: (row, column), (row + 1, column), then of the next column */
    floatw lower[VECTORS], later[VECTORS];
    EACH_VECTOR {
      const floatw p = full(u[0][v]) * of.scale + 0.5f, q = full(u[1][v]) * of.scale + 0.5f;
      const uintw row = WHOLE(p), column = WHOLE(q), first = column * of.step + row;
      lower[v] = p - REAL(row), later[v] = q - REAL(column);
      entry[v][0] = (first & of.mask) * 2, entry[v][1] = ((first + 1) & of.mask) * 2;
      entry[v][2] = ((first + of.step) & of.mask) * 2, entry[v][3] = ((first + of.step + 1) & of.mask) * 2;
    }
    EACH_VECTOR {
      floatw corner[4][2];
      _Pragma("unroll") for (int k = 0; k < 4; k++) {
        KEPT *i = (KEPT *)&entry[v][k];
        PAIRS(corner[k][0], corner[k][1], value, i);
      }
      _Pragma("unroll") for (int c = 0; c < 2; c++) {
        const floatw near = corner[0][c] + later[v] * (corner[2][c] - corner[0][c]);
        const floatw far = corner[1][c] + later[v] * (corner[3][c] - corner[1][c]);
        tile[AT(2 * l + c, v)] = select(near + lower[v] * (far - near), (floatw)(0), outside[v]);
      }
    }
  }
}

LAYER(deform_layer, HIDDEN, HIDDEN)
LAYER(grid_layer, HIDDEN, 2 * LEVELS)
LAYER(hidden_layer, HIDDEN, HIDDEN)
PRODUCT(product_two, 2)
PRODUCT(product_four, 4)

/* First layers. The deformation's, after its ReLU, is in `tile`; the network's, to which the grid's part will be added,
 * is in rows ROW_BEGIN on. */
INLINE void begin(local floatw *tile, const struct segment segment[VECTORS], global const float *rows,
                  global const float *columns, uint padded) {
  for (int j = 0; j < TERMS; j++) {
    EACH_VECTOR {
      const floatw sum =
          full(rows[segment[v].row * TERMS + j] + LOADW(columns + (ulong)j * padded + segment[v].column));
      if (j < HIDDEN)
        tile[AT(j, v)] = select(sum, (floatw)(0), sum < 0);
      else
        tile[AT(ROW_BEGIN + j - HIDDEN, v)] = sum;
    }
  }
}

/* moved = q' of torso_move, where q has row and column. motion [2][CONTROL][CONTROL] */
INLINE void move_with_body(floatw moved[2], const floatw q[2], global const float *motion, float shrink) {
#pragma OPENCL FP_CONTRACT OFF
  floatw toward[2];
  intw cell[2];
  _Pragma("unroll") for (int d = 0; d < 2; d++) {
    const floatw at = clamp(q[d] * ((CONTROL - 1) / 2.0f / shrink) + (CONTROL - 1) / 2.0f, 0.0f, (float)(CONTROL - 1));
    cell[d] = min(INTW(at), CONTROL - 2);
    toward[d] = at - REAL(cell[d]);
  }
  _Pragma("unroll") for (int d = 0; d < 2; d++) {
    const intw at = cell[0] * CONTROL + cell[1] + d * CONTROL * CONTROL, next = at + 1;
    const intw below = at + CONTROL, below_next = below + 1;
    const floatw upper = (1 - toward[1]) * GATHER(floatw, motion, at) + toward[1] * GATHER(floatw, motion, next);
    const floatw lower = (1 - toward[1]) * GATHER(floatw, motion, below) + toward[1] * GATHER(floatw, motion, below_next);
    moved[d] = q[d] + ((1 - toward[0]) * upper + toward[0] * lower);
  }
}

/* u = (clamp(q' + d, -1, 1) + 1)/2, q' being q moved with the body and d the deformation; 0 where that is NaN. */
INLINE void place(floatw u[2][VECTORS], intw outside[VECTORS], floatw moved_by[2][VECTORS],
                  const struct segment segment[VECTORS], global const float *motion, const struct torso_frame *f) {
#pragma OPENCL FP_CONTRACT OFF
  EACH_VECTOR {
    const intw i = segment[v].column + INTW(lane_numbers());
    const floatw q[2] = {
        (floatw)(f->shrink * COORDINATE(float, (float)(2 * segment[v].row - (f->height - 1)), f->height)),
        f->shrink * COORDINATE(floatw, REAL(2 * i - (f->width - 1)), f->width)};
    floatw own[2];
    move_with_body(own, q, motion, f->shrink);
    outside[v] = (intw)(0);
    _Pragma("unroll") for (int d = 0; d < 2; d++) {
      const floatw moved = own[d] + moved_by[d][v];
      const floatw x = select(select(moved, (floatw)(1), moved > 1), (floatw)(-1), moved < -1);
      outside[v] |= x != x;
      u[d][v] = select((x + 1) * 0.5f, (floatw)(0), x != x);
    }
  }
}

/* alpha, rgb of a tile's pixels. */
INLINE void evaluate(floatw layer[4][VECTORS], local floatw *tile, const struct segment segment[VECTORS],
                     const struct torso_frame *f, global const float *rows, global const float *columns, uint padded,
                     global const float *net, global const struct torso_level *level, global const float *table,
                     global const float *motion) {
  local floatw *second = tile + AT(ROW_SECOND, 0);
  floatw u[2][VECTORS], moved_by[2][VECTORS];
  intw outside[VECTORS];
  begin(tile, segment, rows, columns, padded);
  deform_layer(second, 0, 0, net + AT_DEFORM1, tile);
  EACH_ROW(2) EACH_VECTOR moved_by[r][v] = 0;
  product_two(moved_by, net + AT_DEFORM2, second, HIDDEN);
  place(u, outside, moved_by, segment, motion, f);
  encode(tile, u, outside, level, table);
  grid_layer(second, 0, tile + AT(ROW_BEGIN, 0), net + AT_LAYER0, tile);
  hidden_layer(tile, 0, 0, net + AT_LAYER1, second);
  EACH_ROW(4) EACH_VECTOR layer[r][v] = 0;
  product_four(layer, net + AT_LAYER2, tile, HIDDEN);
  EACH_ROW(4) EACH_VECTOR layer[r][v] = 1.002f * sigmoid(full(layer[r][v])) - 0.001f;
}

/* pixel = alpha rgb + (1 - alpha) pixel where chosen; opacity = alpha. */
INLINE void composite(global float *pixel, ulong stride, global float *opacity, floatw layer[4][VECTORS],
                      const struct segment *segment, int v, const struct torso_frame *f) {
  const ulong at = (ulong)segment->row * f->width + segment->column;
  const floatw alpha = layer[0][v];
  const ulong left = (ulong)(f->width - segment->column);
  _Pragma("unroll") for (int c = 0; c < 3; c++) {
    global float *to = pixel + c * stride + at;
    const floatw back = loadw_first(to, left), value = alpha * layer[c + 1][v] + (1 - alpha) * back;
    storew_first(to, select(back, value, segment->chosen), left);
  }
  if (opacity) storew_first(opacity + at, select((floatw)(0), alpha, segment->chosen), left);
}

/* ---- the picture; the caller sets the opacity to zero ---- */

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
render_torso(ROWS(float, pixel), SPAN(float, opacity), SPAN(const float, grid), SPAN(const float, rows),
             SPAN(const float, columns), uint padded, SPAN(const float, net), SPAN(const uchar, levels),
             SPAN(const float, table), SPAN(const float, motion), SPAN(int, counter), const struct torso_frame frame) {
  local floatw tiles[TILE_ROWS * TILE];
  local floatw *tile = tiles + get_local_id(0);
  OPEN(float, pixel);
  OPEN(float, opacity);
  OPEN(const float, motion);
  OPEN(const float, grid);
  OPEN(const float, rows);
  OPEN(const float, columns);
  OPEN(const float, net);
  OPEN(const uchar, levels);
  OPEN(const float, table);
  OPEN(int, counter);
  int row = 0, end = 0, column = 0;
  for (;;) {
    struct segment segment[VECTORS];
    floatw layer[4][VECTORS];
    int count = 0;
    while (count < VECTORS) {
      if (row >= end) {
        const uint patch = (uint)atomic_inc(counter);
        if (patch >= frame.patches) break;
        row = patch / frame.across * PATCH, column = patch % frame.across * WIDTH;
        end = min(row + PATCH, frame.height);
      }
      const intw chosen = choose(&frame, grid, row, column);
      if (ANY(chosen)) {
        segment[count].row = row, segment[count].column = column;
        segment[count++].chosen = chosen;
      }
      row++;
    }
    if (count == 0) break;
    for (int v = count; v < VECTORS; v++) segment[v] = segment[0];
    evaluate(layer, tile, segment, &frame, rows, columns, padded, net, (global const struct torso_level *)levels,
             table, motion);
    for (int v = 0; v < count; v++) composite(pixel, pixel_stride, opacity, layer, &segment[v], v, &frame);
  }
}
