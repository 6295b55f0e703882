/* SPDX-License-Identifier: MIT
 * The fields of an ONNX file (protobuf, onnx.proto of version 1) that must be checked before a reader that trusts them
 * gets the file. */
#include "io/onnx.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"

/* MOST_TYPE: of TensorProto.DataType. Names are looked for one by one; the largest speech networks have some 5,000. */
enum { MOST_NAMES = 16384, MOST_USES = 65536, MOST_TYPE = 16, MOST_SHAPE_TEXT = 160, MOST_AXES = 8 };
enum { WIRE_VARINT = 0, WIRE_64 = 1, WIRE_BYTES = 2, WIRE_32 = 5 };
enum { TYPE_FLOAT = 1, TYPE_UINT8 = 2, TYPE_INT8 = 3, TYPE_INT32 = 6, TYPE_INT64 = 7, TYPE_DOUBLE = 11 };

struct span {
  const uint8_t *at, *end;
};

struct field {
  uint64_t number, value; /* value: of a number; of bytes their count */
  int wire;
  struct span bytes;
};

struct look {
  ern_context *context;
  const char *path;
  const uint8_t *begin; /* of the file */
  struct ern_onnx *onnx;
  struct span *name; /* [names]: of weights, then of inputs, then of the nodes' outputs */
  bool *empty;       /* [names]: a weight without elements */
  size_t names, weights, uses;
};

static size_t length(struct span span) { return (size_t)(span.end - span.at); }

static bool take_varint(struct span *rest, uint64_t *value) {
  *value = 0;
  for (int shift = 0; shift < 70 && rest->at < rest->end; shift += 7) {
    const uint8_t byte = *rest->at++;
    if (shift < 64) *value |= (uint64_t)(byte & 127) << shift;
    if (byte < 128) return true;
  }
  return false;
}

/* Takes the first field off a message: 1; 0 at the end; -1 where there is no whole field. */
static int next_field(struct span *rest, struct field *field) {
  uint64_t tag = 0;
  if (rest->at == rest->end) return 0;
  if (!take_varint(rest, &tag) || tag >> 3 == 0) return -1;
  *field = (struct field){.number = tag >> 3, .wire = (int)(tag & 7), .bytes = *rest};
  switch (field->wire) {
    case WIRE_VARINT: return take_varint(rest, &field->value) ? 1 : -1;
    case WIRE_64: field->value = 8; break;
    case WIRE_32: field->value = 4; break;
    case WIRE_BYTES:
      if (!take_varint(rest, &field->value)) return -1;
      break;
    default: return -1;
  }
  if (field->value > length(*rest)) return -1;
  field->bytes = (struct span){rest->at, rest->at + field->value};
  rest->at = field->bytes.end;
  return 1;
}

static bool is_message(const struct field *field, uint64_t number) {
  return field->number == number && field->wire == WIRE_BYTES;
}

static ern_status fail_at(const struct look *look, const uint8_t *at) {
  return ern_fail(look->context, ERN_E_FORMAT, "%s: is no ONNX file, or a part of one: no whole field at byte %zu",
                  look->path, (size_t)(at - look->begin));
}

/* A name, cut to the size of `text`, with '?' for characters that are not printable ASCII. */
static void copy_name(struct span name, char text[ERN_ONNX_NAME]) {
  size_t count = length(name) < ERN_ONNX_NAME - 1 ? length(name) : ERN_ONNX_NAME - 1;
  for (size_t i = 0; i < count; i++) text[i] = (char)(name.at[i] > 31 && name.at[i] < 127 ? name.at[i] : '?');
  text[count] = 0;
}

/* ---- names ------------------------------------------------------------------------------------------------------- */

static bool is_same(struct span one, struct span other) {
  return length(one) == length(other) && (length(one) == 0 || memcmp(one.at, other.at, length(one)) == 0);
}

static bool is_text(struct span one, const char *text) {
  return is_same(one, (struct span){(const uint8_t *)text, (const uint8_t *)text + strlen(text)});
}

/* Its number among the first `count` names; `count`: it is none of them. */
static size_t find_name(const struct look *look, struct span name, size_t count) {
  size_t i = 0;
  while (i < count && !is_same(look->name[i], name)) i++;
  return i;
}

static ern_status add_name(struct look *look, struct span name, bool empty) {
  if (look->names == MOST_NAMES)
    return ern_fail(look->context, ERN_E_UNSUPPORTED, "%s: has more than %d names", look->path, MOST_NAMES);
  look->empty[look->names] = empty;
  look->name[look->names++] = name;
  return ERN_OK;
}

/* ---- weights ----------------------------------------------------------------------------------------------------- */

struct tensor {
  struct span name;
  uint64_t type, elements; /* elements: the product of its sizes */
  uint64_t floats, doubles, int32s, int64s, raw_bytes;
  bool elsewhere;
};

static uint64_t count_varints(struct span bytes) {
  uint64_t count = 0;
  for (; bytes.at < bytes.end; bytes.at++) count += *bytes.at < 128;
  return count;
}

/* How many numbers a repeated field holds, packed or not. */
static uint64_t numbers(const struct field *field, int wire) {
  if (field->wire == wire) return 1;
  if (field->wire != WIRE_BYTES) return 0;
  return wire == WIRE_VARINT ? count_varints(field->bytes) : field->value / (wire == WIRE_64 ? 8 : 4);
}

/* One more size. */
static bool multiply_size(struct tensor *tensor, uint64_t size) {
  return size <= INT32_MAX && !__builtin_mul_overflow(tensor->elements, size, &tensor->elements);
}

static bool take_sizes(struct tensor *tensor, const struct field *field) {
  struct span rest = field->bytes;
  if (field->wire == WIRE_VARINT) return multiply_size(tensor, field->value);
  if (field->wire != WIRE_BYTES) return true;
  while (rest.at < rest.end) {
    uint64_t size = 0;
    if (!take_varint(&rest, &size) || !multiply_size(tensor, size)) return false;
  }
  return true;
}

/* False where a value is invalid. */
static bool take_tensor_field(struct tensor *tensor, const struct field *field) {
  switch (field->number) {
    case 1: return take_sizes(tensor, field);
    case 2:
      if (field->wire != WIRE_VARINT) return true;
      tensor->type = field->value;
      return field->value <= MOST_TYPE;
    case 4: tensor->floats += numbers(field, WIRE_32); return true;
    case 5: tensor->int32s += numbers(field, WIRE_VARINT); return true;
    case 7: tensor->int64s += numbers(field, WIRE_VARINT); return true;
    case 8:
      if (field->wire == WIRE_BYTES) tensor->name = field->bytes;
      return true;
    case 9:
      if (field->wire == WIRE_BYTES) tensor->raw_bytes = field->value;
      return true;
    case 10: tensor->doubles += numbers(field, WIRE_64); return true;
    case 13: tensor->elsewhere = true; return true;
    case 14: tensor->elsewhere |= field->wire == WIRE_VARINT && field->value != 0; return true;
    default: return true;
  }
}

/* Whether it holds as many numbers as its sizes say. The reader refuses the types that are not listed here. */
static bool is_complete(const struct tensor *t) {
  const bool empty = t->floats == 0 && t->doubles == 0 && t->int32s == 0 && t->int64s == 0 && t->raw_bytes == 0;
  uint64_t listed = 0, bytes = 0;
  switch (t->type) {
    case TYPE_FLOAT: listed = t->floats, bytes = 4; break;
    case TYPE_INT32: listed = t->int32s, bytes = 4; break;
    case TYPE_INT8:
    case TYPE_UINT8: listed = t->int32s, bytes = 1; break;
    case TYPE_INT64: listed = t->int64s, bytes = 8; break;
    case TYPE_DOUBLE: listed = t->doubles, bytes = 8; break;
    default: return true;
  }
  return empty || (listed > 0 ? listed == t->elements : t->elements == t->raw_bytes / bytes);
}

/* *empty: one of its sizes is 0. */
static ern_status check_tensor(const struct look *look, struct span message, struct span *name, bool *empty) {
  struct tensor tensor = {.elements = 1};
  struct field field;
  char words[ERN_ONNX_NAME];
  for (int more = 0; (more = next_field(&message, &field)) != 0;)
    if (more < 0 || !take_tensor_field(&tensor, &field)) return fail_at(look, message.at);
  copy_name(tensor.name, words);
  *name = tensor.name;
  *empty = tensor.elements == 0;
  if (tensor.elsewhere)
    return ern_fail(look->context, ERN_E_UNSUPPORTED,
                    "%s: the weight \"%s\" lies in another file, expected all in one file of less than 2 GiB",
                    look->path, words);
  if (!is_complete(&tensor))
    return ern_fail(look->context, ERN_E_FORMAT, "%s: the weight \"%s\" has not as many numbers as its sizes say",
                    look->path, words);
  return ERN_OK;
}

/* ---- nodes ------------------------------------------------------------------------------------------------------- */

struct node {
  struct span name, kind;
  size_t inputs;
  bool empty; /* a constant without elements */
};

/* "the operator KIND (node NAME)" */
static void node_words(const struct node *node, char words[2 * ERN_ONNX_NAME + 32]) {
  char kind[ERN_ONNX_NAME], name[ERN_ONNX_NAME];
  copy_name(node->kind, kind);
  copy_name(node->name, name);
  snprintf(words, 2 * ERN_ONNX_NAME + 32, "the operator %s (node \"%s\")", kind, name);
}

static ern_status check_number(const struct look *look, const struct node *node, struct span attribute, int64_t value) {
  const bool group = is_text(attribute, "group"), axis = is_text(attribute, "axis") || is_text(attribute, "axes");
  char words[2 * ERN_ONNX_NAME + 32], name[ERN_ONNX_NAME];
  if ((!group || value >= 1) && (!axis || (value >= -MOST_AXES && value < MOST_AXES))) return ERN_OK;
  node_words(node, words);
  copy_name(attribute, name);
  return ern_fail(look->context, ERN_E_FORMAT, "%s: %s has %s %lld, expected %s", look->path, words, name,
                  (long long)value, group ? "1 or more" : "-8 to 7");
}

/* The numbers of an attribute: one, or a list, packed or not. */
static ern_status check_numbers(const struct look *look, const struct node *node, struct span name,
                                struct span attribute) {
  struct field field;
  uint64_t value = 0;
  ern_status status = ERN_OK;
  while (status == ERN_OK && next_field(&attribute, &field) > 0) {
    if ((field.number == 3 || field.number == 8) && field.wire == WIRE_VARINT)
      status = check_number(look, node, name, (int64_t)field.value);
    if (!is_message(&field, 8)) continue;
    while (status == ERN_OK && take_varint(&field.bytes, &value))
      status = check_number(look, node, name, (int64_t)value);
  }
  return status;
}

/* AttributeProto { 1 name, 3 number, 5 tensor, 8 numbers, 10 tensors } */
static ern_status check_attribute(const struct look *look, struct node *node, struct span attribute) {
  struct span rest = attribute, name = {0}, unused;
  struct field field;
  int tensors = 0; /* two would be read as one */
  bool empty = false;
  for (int more = 0; (more = next_field(&rest, &field)) != 0;) {
    if (more < 0) return fail_at(look, rest.at);
    if (is_message(&field, 1)) name = field.bytes;
    if (!is_message(&field, 5) && !is_message(&field, 10)) continue;
    if (is_message(&field, 5) && ++tensors > 1) return fail_at(look, field.bytes.at);
    const ern_status status = check_tensor(look, field.bytes, &unused, &empty);
    if (status != ERN_OK) return status;
    node->empty |= empty;
  }
  return check_numbers(look, node, name, attribute);
}

/* An input of a node must exist: a weight, the input, or an earlier node's output; "" is none. Only Resize may use an
 * empty weight, which its second input usually is. */
static ern_status check_use(struct look *look, const struct node *node, struct span name) {
  char words[ERN_ONNX_NAME], user[2 * ERN_ONNX_NAME + 32];
  if (++look->uses > MOST_USES)
    return ern_fail(look->context, ERN_E_UNSUPPORTED, "%s: its nodes use more than %d names", look->path, MOST_USES);
  if (length(name) == 0) return ERN_OK;
  const size_t at = find_name(look, name, look->names);
  copy_name(name, words);
  if (at == look->names)
    return ern_fail(look->context, ERN_E_FORMAT, "%s: a node uses \"%s\", which is not there", look->path, words);
  if (!look->empty[at] || is_text(node->kind, "Resize")) return ERN_OK;
  node_words(node, user);
  return ern_fail(look->context, ERN_E_FORMAT, "%s: %s uses \"%s\", which has a size of 0, expected 1 or more",
                  look->path, user, words);
}

/* Operators whose second input OpenCV uses without checking that it exists. */
static ern_status check_inputs(const struct look *look, const struct node *node) {
  static const char *const two[] = {"Conv", "ConvTranspose", "CumSum", "Expand", "Gather", "Gemm", "MatMul", "Resize"};
  char words[2 * ERN_ONNX_NAME + 32];
  for (size_t i = 0; i < sizeof two / sizeof *two; i++) {
    if (node->inputs >= 2 || !is_text(node->kind, two[i])) continue;
    node_words(node, words);
    return ern_fail(look->context, ERN_E_FORMAT, "%s: %s has %zu inputs, expected at least 2", look->path, words,
                    node->inputs);
  }
  return ERN_OK;
}

/* NodeProto { 1 input, 2 output, 3 name, 4 kind, 5 attribute } */
static ern_status check_node(struct look *look, struct span message) {
  struct span rest = message;
  struct node node = {0};
  struct field field;
  ern_status status = ERN_OK;
  for (int more = 0; (more = next_field(&rest, &field)) != 0;) {
    if (more < 0) return fail_at(look, rest.at);
    node.inputs += is_message(&field, 1);
    if (is_message(&field, 3)) node.name = field.bytes;
    if (is_message(&field, 4)) node.kind = field.bytes;
  }
  for (rest = message; next_field(&rest, &field) > 0;) {
    if (is_message(&field, 1)) ERN_TRY(check_use(look, &node, field.bytes));
    if (is_message(&field, 5)) ERN_TRY(check_attribute(look, &node, field.bytes));
  }
  ERN_TRY(check_inputs(look, &node));
  while (next_field(&message, &field) > 0)
    if (is_message(&field, 2)) ERN_TRY(add_name(look, field.bytes, node.empty && is_text(node.kind, "Constant")));
fail:
  return status;
}

/* ---- input and outputs ------------------------------------------------------------------------------------------- */

struct value {
  struct span name;
  bool has_shape;
  uint64_t type;
  int dims;
  char text[MOST_SHAPE_TEXT]; /* the shape as a person writes it: "1, samples" */
  char open[ERN_ONNX_NAME];   /* the first size that is not fixed */
  int shape[ERN_ONNX_DIMS];
};

static ern_status take_dimension(const struct look *look, struct span message, struct value *value) {
  struct field field;
  char name[ERN_ONNX_NAME] = "?";
  uint64_t size = 0;
  for (int more = 0; (more = next_field(&message, &field)) != 0;) {
    if (more < 0) return fail_at(look, message.at);
    if (field.number == 1 && field.wire == WIRE_VARINT) size = field.value;
    if (is_message(&field, 2)) copy_name(field.bytes, name), size = 0;
  }
  const bool fixed = size >= 1 && size <= INT32_MAX;
  const size_t used = strlen(value->text), left = sizeof value->text - used;
  if (fixed) snprintf(name, sizeof name, "%d", (int)size);
  snprintf(value->text + used, left, "%s%s", value->dims > 0 ? ", " : "", name);
  if (!fixed && value->open[0] == 0) memcpy(value->open, name, sizeof name);
  if (value->dims < ERN_ONNX_DIMS) value->shape[value->dims] = (int)size;
  value->dims++;
  return ERN_OK;
}

/* TensorShapeProto { 1 dimension, ... } */
static ern_status take_shape(const struct look *look, struct span message, struct value *value) {
  struct field field;
  for (int more = 0; (more = next_field(&message, &field)) != 0;) {
    if (more < 0) return fail_at(look, message.at);
    if (!is_message(&field, 1)) continue;
    const ern_status status = take_dimension(look, field.bytes, value);
    if (status != ERN_OK) return status;
  }
  value->has_shape = true;
  return ERN_OK;
}

/* ValueInfoProto { 1 name, 2 type { 1 tensor { 1 type of its numbers, 2 shape } } } */
static ern_status read_value(const struct look *look, struct span message, struct value *value) {
  struct field field, type, part;
  int more = 0;
  ern_status status = ERN_OK;
  *value = (struct value){0};
  while ((more = next_field(&message, &field)) > 0) {
    if (is_message(&field, 1)) value->name = field.bytes;
    if (!is_message(&field, 2)) continue;
    while ((more = next_field(&field.bytes, &type)) > 0) {
      if (!is_message(&type, 1)) continue;
      while ((more = next_field(&type.bytes, &part)) > 0) {
        if (part.number == 1 && part.wire == WIRE_VARINT) value->type = part.value;
        if (is_message(&part, 2)) status = take_shape(look, part.bytes, value);
        if (status != ERN_OK) return status;
      }
      if (more < 0) return fail_at(look, type.bytes.at);
    }
    if (more < 0) return fail_at(look, field.bytes.at);
  }
  return more == 0 ? ERN_OK : fail_at(look, message.at);
}

static ern_status take_input(struct look *look, struct span message) {
  struct value value;
  char name[ERN_ONNX_NAME];
  struct ern_onnx *onnx = look->onnx;
  const ern_status status = read_value(look, message, &value);
  if (status != ERN_OK || find_name(look, value.name, look->weights) < look->weights) return status;
  copy_name(value.name, name);
  if (onnx->dims > 0)
    return ern_fail(look->context, ERN_E_UNSUPPORTED, "%s: has the inputs \"%s\" and \"%s\", expected one", look->path,
                    onnx->input, name);
  if (!value.has_shape || value.dims < 1 || value.dims > ERN_ONNX_DIMS || value.type != TYPE_FLOAT)
    return ern_fail(look->context, ERN_E_UNSUPPORTED,
                    "%s: its input \"%s\" has %d sizes and numbers of type %d, expected 1 to %d and type %d (float)",
                    look->path, name, value.dims, (int)value.type, ERN_ONNX_DIMS, TYPE_FLOAT);
  if (value.open[0] != 0)
    return ern_fail(look->context, ERN_E_UNSUPPORTED,
                    "%s: its input \"%s\" is [%s], and \"%s\" is not fixed; export it with fixed sizes: "
                    "torch.onnx.export without dynamic_axes",
                    look->path, name, value.text, value.open);
  memcpy(onnx->input, name, sizeof name);
  memcpy(onnx->shape, value.shape, sizeof value.shape);
  onnx->dims = value.dims;
  return add_name(look, value.name, false);
}

static ern_status take_output(struct look *look, struct span message) {
  struct value value;
  struct ern_onnx *onnx = look->onnx;
  const ern_status status = read_value(look, message, &value);
  char name[ERN_ONNX_NAME];
  copy_name(value.name, name);
  if (status != ERN_OK) return status;
  if (!value.has_shape)
    return ern_fail(look->context, ERN_E_UNSUPPORTED, "%s: its output \"%s\" has no sizes, expected them", look->path,
                    name);
  if (onnx->outputs < ERN_ONNX_OUTPUTS) memcpy(onnx->output[onnx->outputs], name, sizeof name);
  onnx->outputs++;
  return ERN_OK;
}

/* ---- the file ---------------------------------------------------------------------------------------------------- */

/* Checks that the graph is a valid message, and its weights; stores their names. */
static ern_status take_weights(struct look *look, struct span graph) {
  struct field field;
  struct span name;
  bool empty = false;
  ern_status status = ERN_OK;
  for (int more = 0; (more = next_field(&graph, &field)) != 0;) {
    if (more < 0) return fail_at(look, graph.at);
    if (!is_message(&field, 5)) continue;
    ERN_TRY(check_tensor(look, field.bytes, &name, &empty));
    ERN_TRY(add_name(look, name, empty));
  }
  look->weights = look->names;
fail:
  return status;
}

static ern_status take_values(struct look *look, struct span graph) {
  struct field field;
  ern_status status = ERN_OK;
  while (next_field(&graph, &field) > 0) {
    if (is_message(&field, 11)) ERN_TRY(take_input(look, field.bytes));
    if (is_message(&field, 12)) ERN_TRY(take_output(look, field.bytes));
  }
  if (look->onnx->dims == 0 || look->onnx->outputs == 0)
    ERN_TRY(ern_fail(look->context, ERN_E_FORMAT, "%s: is an ONNX file without an %s", look->path,
                     look->onnx->dims > 0 ? "output" : "input"));
fail:
  return status;
}

static ern_status check_nodes(struct look *look, struct span graph) {
  struct field field;
  ern_status status = ERN_OK;
  while (status == ERN_OK && next_field(&graph, &field) > 0)
    if (is_message(&field, 1)) status = check_node(look, field.bytes);
  return status;
}

ern_status ern_onnx_inspect(ern_context *context, const char *path, const uint8_t *bytes, size_t count,
                            struct ern_onnx *onnx) {
  struct look look = {.context = context, .path = path, .begin = bytes, .onnx = onnx};
  struct span file = {bytes, bytes + count}, graph = {0};
  struct field field;
  ern_status status = ERN_OK;
  *onnx = (struct ern_onnx){0};
  for (int more = 0; (more = next_field(&file, &field)) != 0;) {
    if (more < 0 || (is_message(&field, 7) && graph.at != NULL)) return fail_at(&look, file.at);
    if (is_message(&field, 7)) graph = field.bytes;
  }
  if (graph.at == NULL)
    return ern_fail(context, ERN_E_FORMAT, "%s: is no ONNX file: %zu bytes without a graph", path, count);
  ERN_TRY(ERN_NEW(context, MOST_NAMES, &look.name));
  ERN_TRY(ERN_NEW(context, MOST_NAMES, &look.empty));
  ERN_TRY(take_weights(&look, graph));
  ERN_TRY(take_values(&look, graph));
  ERN_TRY(check_nodes(&look, graph));
fail:
  ern_release(context, look.name);
  ern_release(context, look.empty);
  return status;
}
