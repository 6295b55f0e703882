/* SPDX-License-Identifier: MIT
 * Small networks as ONNX files, written field by field. */
#ifndef ERN_TESTS_MADE_ONNX_H
#define ERN_TESTS_MADE_ONNX_H

#include "support.h"

struct made_message {
  uint8_t *bytes;
  size_t count;
};

static inline void made_put(struct made_message *to, const void *bytes, size_t count) {
  to->bytes = (uint8_t *)realloc(to->bytes, to->count + count + 1);
  assert_non_null(to->bytes);
  if (count > 0) memcpy(to->bytes + to->count, bytes, count);
  to->count += count;
}

static inline void made_varint(struct made_message *to, uint64_t value) {
  for (; value > 127; value >>= 7) made_put(to, &(uint8_t){(uint8_t)(128 | (value & 127))}, 1);
  made_put(to, &(uint8_t){(uint8_t)value}, 1);
}

static inline void made_number(struct made_message *to, unsigned field, uint64_t value) {
  made_varint(to, field << 3);
  made_varint(to, value);
}

static inline void made_bytes(struct made_message *to, unsigned field, const void *bytes, size_t count) {
  made_varint(to, field << 3 | 2);
  made_varint(to, count);
  made_put(to, bytes, count);
}

static inline void made_text(struct made_message *to, unsigned field, const char *text) {
  made_bytes(to, field, text, strlen(text));
}

/* Takes the inner message. */
static inline void made_inside(struct made_message *to, unsigned field, struct made_message *inner) {
  made_bytes(to, field, inner->bytes, inner->count);
  free(inner->bytes);
  *inner = (struct made_message){0};
}

/* A weight of float numbers; sizes end with 0. */
static inline void made_weight(struct made_message *graph, const char *name, const size_t *sizes, const float *values) {
  struct made_message tensor = {0};
  size_t count = 1;
  for (; *sizes != 0; sizes++) made_number(&tensor, 1, *sizes), count *= *sizes;
  made_number(&tensor, 2, 1);
  made_text(&tensor, 8, name);
  made_bytes(&tensor, 9, values, count * sizeof *values);
  made_inside(graph, 5, &tensor);
}

/* A weight of whole numbers, as shapes are. */
static inline void made_sizes(struct made_message *graph, const char *name, size_t count, const int64_t *values) {
  struct made_message tensor = {0};
  made_number(&tensor, 1, count);
  made_number(&tensor, 2, 7);
  made_text(&tensor, 8, name);
  made_bytes(&tensor, 9, values, count * sizeof *values);
  made_inside(graph, 5, &tensor);
}

/* One attribute of a node: whole numbers. */
struct made_attribute {
  const char *name;
  size_t count;
  uint64_t values[4];
};

/* inputs: names split at spaces. The attributes end with one without a name. */
static inline void made_node(struct made_message *graph, const char *kind, const char *inputs, const char *output,
                             const struct made_attribute *attributes) {
  struct made_message node = {0};
  for (const char *at = inputs; *at != 0;) {
    const size_t length = strcspn(at, " ");
    made_bytes(&node, 1, at, length);
    at += length + (at[length] != 0);
  }
  made_text(&node, 2, output);
  made_text(&node, 3, output);
  made_text(&node, 4, kind);
  for (; attributes != NULL && attributes->name != NULL; attributes++) {
    struct made_message attribute = {0};
    made_text(&attribute, 1, attributes->name);
    for (size_t i = 0; i < attributes->count; i++) made_number(&attribute, 8, attributes->values[i]);
    made_number(&attribute, 20, 7);
    made_inside(&node, 5, &attribute);
  }
  made_inside(graph, 1, &node);
}

/* field: 11 an input, 12 an output; of float numbers. Sizes end with 0; one of SIZE_MAX is open, by the name
 * "samples". */
static inline void made_value(struct made_message *graph, unsigned field, const char *name, const size_t *sizes) {
  struct made_message shape = {0}, tensor = {0}, type = {0}, value = {0};
  for (; *sizes != 0; sizes++) {
    struct made_message size = {0};
    if (*sizes == SIZE_MAX)
      made_text(&size, 2, "samples");
    else
      made_number(&size, 1, *sizes);
    made_inside(&shape, 1, &size);
  }
  made_number(&tensor, 1, 1);
  made_inside(&tensor, 2, &shape);
  made_inside(&type, 1, &tensor);
  made_text(&value, 1, name);
  made_inside(&value, 2, &type);
  made_inside(graph, field, &value);
}

/* Writes the file and takes the graph. */
static inline void made_onnx(const char *path, struct made_message *graph) {
  struct made_message model = {0}, opset = {0};
  made_number(&opset, 2, 13);
  made_number(&model, 1, 7); /* version of the format */
  made_inside(&model, 8, &opset);
  made_inside(&model, 7, graph);
  support_write(path, model.bytes, model.count);
  free(model.bytes);
}

/* A 1D convolution over samples, with the output "rows": rows[r][q] = sum_k weight[q][k] x[r hop + k]. */
struct made_convolution {
  size_t samples, hop, span, width; /* span: samples of a row's window */
  const float *weight;              /* [width][span] */
};

static inline void made_convolve(struct made_message *graph, const struct made_convolution *c, const char *output) {
  const size_t rows = (c->samples - c->span) / c->hop + 1;
  made_weight(graph, "W", (const size_t[]){c->width, 1, c->span, 0}, c->weight);
  made_node(graph, "Conv", "wave W", "convolved",
            (const struct made_attribute[]){{"kernel_shape", 1, {c->span}}, {"strides", 1, {c->hop}}, {NULL, 0, {0}}});
  made_node(graph, "Transpose", "convolved", output,
            (const struct made_attribute[]){{"perm", 3, {0, 2, 1}}, {NULL, 0, {0}}});
  made_value(graph, 11, "wave", (const size_t[]){1, 1, c->samples, 0});
  made_value(graph, 12, output, (const size_t[]){1, rows, c->width, 0});
}

#endif
