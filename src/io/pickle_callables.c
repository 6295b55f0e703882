/* SPDX-License-Identifier: MIT */
#include "io/pickle_callables.h"

#include <string.h>

#include "core/memory.h"
#include "io/half.h"

enum {
  CALL_TENSOR,
  CALL_FIRST_TENSOR,
  CALL_PARAMETER,
  CALL_ORDERED,
  CALL_STORAGE,
  CALL_NUMPY_SCALAR,
  CALL_NUMPY_DTYPE,
  CALL_ENCODE
};

static const struct {
  const char *module, *name;
  int call;
  ern_dtype dtype; /* of a storage */
} callables[] = {{"torch._utils", "_rebuild_tensor_v2", CALL_TENSOR, 0},
                 {"torch._utils", "_rebuild_tensor", CALL_FIRST_TENSOR, 0},
                 {"torch._utils", "_rebuild_parameter", CALL_PARAMETER, 0},
                 {"collections", "OrderedDict", CALL_ORDERED, 0},
                 {"torch", "FloatStorage", CALL_STORAGE, ERN_F32},
                 {"torch", "HalfStorage", CALL_STORAGE, ERN_F16},
                 {"torch", "BFloat16Storage", CALL_STORAGE, ERN_BF16},
                 {"torch", "DoubleStorage", CALL_STORAGE, ERN_F64},
                 {"torch", "ByteStorage", CALL_STORAGE, ERN_U8},
                 {"torch", "CharStorage", CALL_STORAGE, ERN_I8},
                 {"torch", "BoolStorage", CALL_STORAGE, ERN_BOOL},
                 {"torch", "ShortStorage", CALL_STORAGE, ERN_I16},
                 {"torch", "IntStorage", CALL_STORAGE, ERN_I32},
                 {"torch", "LongStorage", CALL_STORAGE, ERN_I64},
                 {"numpy.core.multiarray", "scalar", CALL_NUMPY_SCALAR, 0},
                 {"numpy._core.multiarray", "scalar", CALL_NUMPY_SCALAR, 0},
                 {"numpy", "dtype", CALL_NUMPY_DTYPE, 0},
                 {"_codecs", "encode", CALL_ENCODE, 0}};
enum { CALLABLES = sizeof callables / sizeof callables[0] };

ern_status ern_pickle_find_callable(struct ern_pickle_machine *m, const char *module, const char *name, int *number) {
  for (int i = 0; i < CALLABLES; i++) {
    if (strcmp(module, callables[i].module) != 0 || strcmp(name, callables[i].name) != 0) continue;
    *number = i;
    return ERN_OK;
  }
  return ern_fail(m->context, ERN_E_UNSUPPORTED,
                  "%s: opcode 0x%02x at offset %zu: %.100s.%.100s is none of the callables that tensors need", m->where,
                  m->opcode, m->begin, module, name);
}

static ern_status wrong(const struct ern_pickle_machine *m, const char *what) {
  return ern_fail(m->context, ERN_E_FORMAT, "%s: opcode 0x%02x at offset %zu: %s", m->where, m->opcode, m->begin, what);
}

static bool is_text(const struct ern_pickle_value *value, const char *text) {
  return value->kind == ERN_PICKLE_TEXT && value->as.words.length == strlen(text) &&
         memcmp(value->as.words.text, text, value->as.words.length) == 0;
}

/* ---- tensors ----------------------------------------------------------------------------------------------------- */

ern_status ern_pickle_storage(struct ern_pickle_machine *m, const struct ern_pickle_value *id,
                              struct ern_pickle_value **storage) {
  struct ern_pickle_value *const *part = id->as.list.item;
  *storage = NULL;
  const size_t parts = id->kind == ERN_PICKLE_TUPLE ? id->as.list.count : 0;
  if (parts < 5 || parts > 6 || !is_text(part[0], "storage") || part[1]->kind != ERN_PICKLE_CALLABLE ||
      callables[part[1]->as.integer].call != CALL_STORAGE || part[2]->kind != ERN_PICKLE_TEXT ||
      part[3]->kind != ERN_PICKLE_TEXT || part[4]->kind != ERN_PICKLE_INT || part[4]->as.integer < 0)
    return wrong(m, "expected a storage: its type, key, place and count");
  if (parts == 6 && part[5]->kind != ERN_PICKLE_NONE) /* before PyTorch 1.6: describes a view of another storage */
    return ern_fail(m->context, ERN_E_UNSUPPORTED, "%s: opcode 0x%02x at offset %zu: a view of another storage",
                    m->where, m->opcode, m->begin);
  if (part[2]->as.words.length == 0 || part[2]->as.words.length > 100 ||
      strlen(part[2]->as.words.text) != part[2]->as.words.length)
    return wrong(m, "the key of a storage is empty, longer than 100 bytes or holds a 0");
  const ern_status status = ern_pickle_make(m, ERN_PICKLE_STORAGE, storage);
  if (status != ERN_OK) return status;
  (*storage)->as.storage.key = part[2]->as.words.text;
  (*storage)->as.storage.dtype = callables[part[1]->as.integer].dtype;
  (*storage)->as.storage.count = (size_t)part[4]->as.integer;
  return ERN_OK;
}

static ern_status take_sizes(struct ern_pickle_machine *m, const struct ern_pickle_value *list,
                             size_t sizes[ERN_TENSOR_MAX_DIMS]) {
  for (size_t i = 0; i < list->as.list.count; i++) {
    const struct ern_pickle_value *size = list->as.list.item[i];
    if (size->kind != ERN_PICKLE_INT || size->as.integer < 0) return wrong(m, "a size or stride is no number from 0");
    sizes[i] = (size_t)size->as.integer;
  }
  return ERN_OK;
}

/* The last element that the view reaches must lie in its storage. */
static ern_status check_view(const struct ern_pickle_machine *m, const struct ern_pickle_value *tensor) {
  size_t last = tensor->as.tensor.offset, count = 1;
  const size_t have = tensor->as.tensor.storage->as.storage.count;
  for (int d = 0; d < tensor->as.tensor.dims; d++)
    if (!ern_size_multiply(count, tensor->as.tensor.shape[d], &count)) return wrong(m, "the shape is too large");
  if (count == 0) return ERN_OK;
  for (int d = 0; d < tensor->as.tensor.dims; d++) {
    size_t way = 0;
    if (!ern_size_multiply(tensor->as.tensor.shape[d] - 1, tensor->as.tensor.stride[d], &way) ||
        !ern_size_add(last, way, &last))
      return wrong(m, "offset, shape and strides are too large");
  }
  if (last < have) return ERN_OK;
  return ern_fail(m->context, ERN_E_SHAPE,
                  "%s: opcode 0x%02x at offset %zu: a tensor reaches element %zu of storage %s, which has %zu",
                  m->where, m->opcode, m->begin, last, tensor->as.tensor.storage->as.storage.key, have);
}

/* storage, offset, shape, strides; not `first`: requires_grad, hooks [, metadata] */
static ern_status call_tensor(struct ern_pickle_machine *m, bool first, const struct ern_pickle_value *arguments,
                              struct ern_pickle_value **made) {
  struct ern_pickle_value *const *part = arguments->as.list.item;
  const size_t count = arguments->as.list.count;
  if (count < (first ? 4 : 6) || count > (first ? 4 : 7) || part[0]->kind != ERN_PICKLE_STORAGE ||
      part[1]->kind != ERN_PICKLE_INT || part[1]->as.integer < 0 || part[2]->kind != ERN_PICKLE_TUPLE ||
      part[3]->kind != ERN_PICKLE_TUPLE || part[2]->as.list.count != part[3]->as.list.count)
    return wrong(m, "expected the storage, offset, shape and strides of a tensor");
  if (count == 7 && !(ern_pickle_is_dict(part[6]) && part[6]->as.list.count == 0) && part[6]->kind != ERN_PICKLE_NONE)
    return ern_fail(m->context, ERN_E_UNSUPPORTED,
                    "%s: opcode 0x%02x at offset %zu: a conjugated or negated view of a tensor", m->where, m->opcode,
                    m->begin);
  if (part[2]->as.list.count > ERN_TENSOR_MAX_DIMS)
    return ern_fail(m->context, ERN_E_SHAPE,
                    "%s: opcode 0x%02x at offset %zu: a tensor with %zu sizes, expected at most %d", m->where,
                    m->opcode, m->begin, part[2]->as.list.count, ERN_TENSOR_MAX_DIMS);
  ern_status status = ern_pickle_make(m, ERN_PICKLE_TENSOR, made);
  if (status != ERN_OK) return status;
  (*made)->as.tensor.storage = part[0];
  (*made)->as.tensor.offset = (size_t)part[1]->as.integer;
  (*made)->as.tensor.dims = (int)part[2]->as.list.count;
  status = take_sizes(m, part[2], (*made)->as.tensor.shape);
  if (status == ERN_OK) status = take_sizes(m, part[3], (*made)->as.tensor.stride);
  if (status == ERN_OK) status = check_view(m, *made);
  return status;
}

/* No argument, or, as Python 2 writes it, a list of [key, value] lists. */
static ern_status call_ordered(struct ern_pickle_machine *m, const struct ern_pickle_value *arguments,
                               struct ern_pickle_value **made) {
  ern_status status = ern_pickle_make(m, ERN_PICKLE_ORDERED, made);
  if (status != ERN_OK || arguments->as.list.count == 0) return status;
  const struct ern_pickle_value *pairs = arguments->as.list.item[0];
  if (arguments->as.list.count > 1 || pairs->kind != ERN_PICKLE_LIST)
    return wrong(m, "expected an ordered dict that is empty or made of a list");
  for (size_t i = 0; i < pairs->as.list.count && status == ERN_OK; i++) {
    const struct ern_pickle_value *pair = pairs->as.list.item[i];
    if ((pair->kind != ERN_PICKLE_LIST && pair->kind != ERN_PICKLE_TUPLE) || pair->as.list.count != 2)
      return wrong(m, "an item of an ordered dict is no key with its value");
    for (int k = 0; k < 2 && status == ERN_OK; k++) status = ern_pickle_append(m, *made, pair->as.list.item[k]);
  }
  return status;
}

/* ---- numpy scalars ----------------------------------------------------------------------------------------------- */

/* A text such as "f8" as type and size. */
static ern_status call_numpy_dtype(struct ern_pickle_machine *m, const struct ern_pickle_value *arguments,
                                   struct ern_pickle_value **made) {
  const struct ern_pickle_value *name = arguments->as.list.count > 0 ? arguments->as.list.item[0] : NULL;
  if (name == NULL || name->kind != ERN_PICKLE_TEXT || name->as.words.length != 2 ||
      strchr("biuf", name->as.words.text[0]) == NULL || strchr("1248", name->as.words.text[1]) == NULL)
    return wrong(m, "expected a numpy dtype of b1, i1 to i8, u1 to u8 or f2 to f8");
  if ((name->as.words.text[0] == 'f' && name->as.words.text[1] == '1') ||
      (name->as.words.text[0] == 'b' && name->as.words.text[1] != '1'))
    return wrong(m, "there is no such numpy dtype");
  const ern_status status = ern_pickle_make(m, ERN_PICKLE_NUMPY_DTYPE, made);
  if (status != ERN_OK) return status;
  (*made)->as.numpy.type = name->as.words.text[0];
  (*made)->as.numpy.bytes = name->as.words.text[1] - '0';
  (*made)->as.numpy.order = '<';
  return ERN_OK;
}

static double float_of(uint64_t bits, int bytes) {
  double value;
  if (bytes == 2) return (double)ern_half_to_float((uint16_t)bits);
  if (bytes == 4) return (double)ern_float_of_bits((uint32_t)bits);
  memcpy(&value, &bits, sizeof value);
  return value;
}

static ern_status call_numpy_scalar(struct ern_pickle_machine *m, const struct ern_pickle_value *arguments,
                                    struct ern_pickle_value **made) {
  struct ern_pickle_value *const *part = arguments->as.list.item;
  if (arguments->as.list.count != 2 || part[0]->kind != ERN_PICKLE_NUMPY_DTYPE || part[1]->kind != ERN_PICKLE_BYTES ||
      part[1]->as.words.length != (size_t)part[0]->as.numpy.bytes)
    return wrong(m, "expected a numpy dtype and its bytes");
  const int bytes = part[0]->as.numpy.bytes;
  const char type = part[0]->as.numpy.type;
  uint64_t bits = 0;
  for (int i = 0; i < bytes; i++) {
    const int at = part[0]->as.numpy.order == '>' ? bytes - 1 - i : i;
    bits |= (uint64_t)(uint8_t)part[1]->as.words.text[at] << (8 * i);
  }
  if (type == 'i' && bytes < 8 && (bits >> (8 * bytes - 1) & 1) != 0) bits |= ~(uint64_t)0 << (8 * bytes);
  if (type == 'u' && bits > INT64_MAX) return wrong(m, "a number over 2^63 - 1");
  const ern_status status =
      ern_pickle_make(m, type == 'f' ? ERN_PICKLE_FLOAT : (type == 'b' ? ERN_PICKLE_BOOL : ERN_PICKLE_INT), made);
  if (status != ERN_OK) return status;
  if (type == 'f')
    (*made)->as.real = float_of(bits, bytes);
  else
    (*made)->as.integer = type == 'b' ? bits != 0 : (int64_t)bits;
  return ERN_OK;
}

/* How protocol 2 represents bytes: a text whose characters U+0000 to U+00FF are the bytes. */
static ern_status call_encode(struct ern_pickle_machine *m, const struct ern_pickle_value *arguments,
                              struct ern_pickle_value **made) {
  struct ern_pickle_value *const *part = arguments->as.list.item;
  if (arguments->as.list.count != 2 || part[0]->kind != ERN_PICKLE_TEXT || !is_text(part[1], "latin1"))
    return wrong(m, "expected a text and latin1");
  ern_status status = ern_pickle_make(m, ERN_PICKLE_BYTES, made);
  if (status != ERN_OK) return status;
  char *to = ern_pickle_allocate(m, part[0]->as.words.length + 1, &status);
  if (status != ERN_OK) return status;
  const uint8_t *from = (const uint8_t *)part[0]->as.words.text;
  size_t count = 0;
  for (size_t i = 0; i < part[0]->as.words.length; i++) {
    if (from[i] < 0x80) {
      to[count++] = (char)from[i];
    } else if ((from[i] == 0xc2 || from[i] == 0xc3) && (from[i + 1] & 0xc0) == 0x80) {
      to[count++] = (char)((from[i] & 3) << 6 | (from[i + 1] & 0x3f));
      i++;
    } else {
      return wrong(m, "a character that latin1 lacks");
    }
  }
  to[count] = 0;
  (*made)->as.words.text = to;
  (*made)->as.words.length = count;
  return ERN_OK;
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

ern_status ern_pickle_call(struct ern_pickle_machine *m, int callable, const struct ern_pickle_value *arguments,
                           struct ern_pickle_value **made) {
  const size_t count = arguments->as.list.count;
  *made = NULL;
  switch (callables[callable].call) {
    case CALL_TENSOR: return call_tensor(m, false, arguments, made);
    case CALL_FIRST_TENSOR: return call_tensor(m, true, arguments, made);
    case CALL_PARAMETER:
      if (count != 3 || arguments->as.list.item[0]->kind != ERN_PICKLE_TENSOR) return wrong(m, "expected a tensor");
      *made = arguments->as.list.item[0];
      return ERN_OK;
    case CALL_ORDERED: return call_ordered(m, arguments, made);
    case CALL_NUMPY_DTYPE: return call_numpy_dtype(m, arguments, made);
    case CALL_NUMPY_SCALAR: return call_numpy_scalar(m, arguments, made);
    case CALL_ENCODE: return call_encode(m, arguments, made);
    default: return wrong(m, "a storage type is not called");
  }
}

ern_status ern_pickle_build(struct ern_pickle_machine *m, struct ern_pickle_value *object,
                            const struct ern_pickle_value *state) {
  if (object->kind == ERN_PICKLE_ORDERED && ern_pickle_is_dict(state)) return ERN_OK;
  if (object->kind != ERN_PICKLE_NUMPY_DTYPE || state->kind != ERN_PICKLE_TUPLE || state->as.list.count < 2)
    return wrong(m, "only an ordered dict or a numpy dtype takes attributes");
  const struct ern_pickle_value *order = state->as.list.item[1];
  if (!is_text(order, "<") && !is_text(order, ">") && !is_text(order, "|") && !is_text(order, "="))
    return wrong(m, "the byte order of a numpy dtype is unknown");
  object->as.numpy.order = order->as.words.text[0];
  return ERN_OK;
}
