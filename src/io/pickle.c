/* SPDX-License-Identifier: MIT */
#include "io/pickle.h"

#include <string.h>

#include "core/memory.h"
#include "io/pickle_callables.h"

enum {
  STACK_LIMIT = 1 << 20,
  MEMO_LIMIT = 1 << 20,
};

/* ---- stack and memo ---------------------------------------------------------------------------------------------- */

static ern_status damaged(const struct ern_pickle_machine *m, const char *what) {
  return ern_fail(m->context, ERN_E_FORMAT, "%s: opcode 0x%02x at offset %zu: %s", m->where, m->opcode, m->begin, what);
}

static ern_status grow(struct ern_pickle_machine *m, struct ern_pickle_pointers *list, size_t need) {
  if (need <= list->capacity) return ERN_OK;
  size_t capacity = list->capacity > 0 ? list->capacity : 64;
  while (capacity < need) capacity *= 2;
  struct ern_pickle_value **fresh = NULL;
  const ern_status status = ERN_NEW(m->context, capacity, &fresh);
  if (status != ERN_OK) return status;
  if (list->capacity > 0) memcpy(fresh, list->item, list->capacity * sizeof list->item[0]);
  ern_release(m->context, list->item);
  list->item = fresh;
  list->capacity = capacity;
  return ERN_OK;
}

static ern_status push(struct ern_pickle_machine *m, struct ern_pickle_value *value) {
  if (m->stack.count >= STACK_LIMIT)
    return ern_fail(m->context, ERN_E_SHAPE, "%s: more than %d values on the stack", m->where, STACK_LIMIT);
  const ern_status status = grow(m, &m->stack, m->stack.count + 1);
  if (status == ERN_OK) m->stack.item[m->stack.count++] = value;
  return status;
}

/* The topmost value; a mark does not count as one. */
static ern_status pop(struct ern_pickle_machine *m, struct ern_pickle_value **value) {
  *value = NULL;
  if (m->stack.count == 0 || m->stack.item[m->stack.count - 1]->kind == ERN_PICKLE_MARK)
    return damaged(m, "the stack is empty");
  *value = m->stack.item[--m->stack.count];
  return ERN_OK;
}

static ern_status top(const struct ern_pickle_machine *m, struct ern_pickle_value **value) {
  *value = NULL;
  if (m->stack.count == 0 || m->stack.item[m->stack.count - 1]->kind == ERN_PICKLE_MARK)
    return damaged(m, "the stack is empty");
  *value = m->stack.item[m->stack.count - 1];
  return ERN_OK;
}

/* Takes the values above the last mark, and the mark, off the stack; they stay readable at *first. */
static ern_status pop_mark(struct ern_pickle_machine *m, struct ern_pickle_value ***first, size_t *count) {
  size_t at = m->stack.count;
  while (at > 0 && m->stack.item[at - 1]->kind != ERN_PICKLE_MARK) at--;
  if (at == 0) return damaged(m, "there is no mark");
  *first = m->stack.item + at;
  *count = m->stack.count - at;
  m->stack.count = at - 1;
  return ERN_OK;
}

static ern_status memo_put(struct ern_pickle_machine *m, size_t number) {
  struct ern_pickle_value *value = NULL;
  ern_status status = top(m, &value);
  if (status != ERN_OK) return status;
  if (number >= MEMO_LIMIT)
    return ern_fail(m->context, ERN_E_SHAPE, "%s: memo %zu at offset %zu, expected below %d", m->where, number,
                    m->begin, MEMO_LIMIT);
  status = grow(m, &m->memo, number + 1);
  if (status != ERN_OK) return status;
  if (m->memo.item[number] == NULL) m->memo.count++;
  m->memo.item[number] = value;
  return ERN_OK;
}

static ern_status memo_get(struct ern_pickle_machine *m, size_t number) {
  if (number >= m->memo.capacity || m->memo.item[number] == NULL)
    return damaged(m, "nothing was put under that memo number");
  return push(m, m->memo.item[number]);
}

/* ---- words of the stream ----------------------------------------------------------------------------------------- */

static ern_status take(struct ern_pickle_machine *m, size_t count, const uint8_t **bytes) {
  *bytes = m->bytes + m->at;
  if (count > m->count - m->at) return damaged(m, "the pickle ends inside it");
  m->at += count;
  return ERN_OK;
}

static ern_status take_number(struct ern_pickle_machine *m, size_t bytes, uint64_t *number) {
  const uint8_t *from = NULL;
  const ern_status status = take(m, bytes, &from);
  *number = 0;
  for (size_t i = 0; status == ERN_OK && i < bytes; i++) *number |= (uint64_t)from[i] << (8 * i);
  return status;
}

static ern_status push_integer(struct ern_pickle_machine *m, ern_pickle_kind kind, int64_t integer) {
  struct ern_pickle_value *value = NULL;
  const ern_status status = ern_pickle_make(m, kind, &value);
  if (status != ERN_OK) return status;
  value->as.integer = integer;
  return push(m, value);
}

/* Little endian, two's complement, of at most 8 bytes. */
static ern_status push_long(struct ern_pickle_machine *m, size_t bytes) {
  uint64_t number = 0;
  if (bytes > 8)
    return ern_fail(m->context, ERN_E_UNSUPPORTED,
                    "%s: opcode 0x%02x at offset %zu: a whole number of %zu bytes, expected at most 8", m->where,
                    m->opcode, m->begin, bytes);
  const ern_status status = take_number(m, bytes, &number);
  if (status != ERN_OK) return status;
  if (bytes > 0 && bytes < 8 && (number >> (8 * bytes - 1) & 1) != 0) number |= ~(uint64_t)0 << (8 * bytes);
  return push_integer(m, ERN_PICKLE_INT, (int64_t)number);
}

/* Big endian. */
static ern_status push_float(struct ern_pickle_machine *m) {
  const uint8_t *from = NULL;
  struct ern_pickle_value *value = NULL;
  uint64_t bits = 0;
  ern_status status = take(m, 8, &from);
  if (status == ERN_OK) status = ern_pickle_make(m, ERN_PICKLE_FLOAT, &value);
  if (status != ERN_OK) return status;
  for (int i = 0; i < 8; i++) bits = bits << 8 | from[i];
  memcpy(&value->as.real, &bits, sizeof bits);
  return push(m, value);
}

static ern_status make_words(struct ern_pickle_machine *m, ern_pickle_kind kind, const uint8_t *from, size_t count,
                             struct ern_pickle_value **value) {
  ern_status status = ern_pickle_make(m, kind, value);
  if (status != ERN_OK) return status;
  char *copy = ern_pickle_allocate(m, count + 1, &status);
  if (status != ERN_OK) return status;
  memcpy(copy, from, count);
  copy[count] = 0;
  (*value)->as.words.text = copy;
  (*value)->as.words.length = count;
  return ERN_OK;
}

static ern_status push_words(struct ern_pickle_machine *m, ern_pickle_kind kind, size_t length_bytes) {
  uint64_t length = 0;
  const uint8_t *from = NULL;
  struct ern_pickle_value *value = NULL;
  ern_status status = take_number(m, length_bytes, &length);
  if (status != ERN_OK) return status;
  if (length > m->count) return damaged(m, "a text longer than the pickle");
  status = take(m, (size_t)length, &from);
  if (status == ERN_OK) status = make_words(m, kind, from, (size_t)length, &value);
  if (status == ERN_OK) status = push(m, value);
  return status;
}

/* ---- callables --------------------------------------------------------------------------------------------------- */

/* A line up to its newline, which is skipped. */
static ern_status take_line(struct ern_pickle_machine *m, char *line, size_t capacity) {
  const uint8_t *from = m->bytes + m->at;
  const uint8_t *end = m->at < m->count ? memchr(from, '\n', m->count - m->at) : NULL;
  if (end == NULL) return damaged(m, "the pickle ends inside a name");
  const size_t length = (size_t)(end - from);
  if (length >= capacity) return damaged(m, "a name of more than 200 bytes");
  for (size_t i = 0; i < length; i++) line[i] = from[i] >= 32 && from[i] < 127 ? (char)from[i] : '?';
  line[length] = 0;
  m->at += length + 1;
  return ERN_OK;
}

static ern_status push_global(struct ern_pickle_machine *m) {
  char module[200], name[200];
  ern_status status = take_line(m, module, sizeof module);
  if (status == ERN_OK) status = take_line(m, name, sizeof name);
  int number = 0;
  if (status == ERN_OK) status = ern_pickle_find_callable(m, module, name, &number);
  return status == ERN_OK ? push_integer(m, ERN_PICKLE_CALLABLE, number) : status;
}

static ern_status push_stack_global(struct ern_pickle_machine *m) {
  struct ern_pickle_value *module = NULL, *name = NULL;
  int number = 0;
  ern_status status = pop(m, &name);
  if (status == ERN_OK) status = pop(m, &module);
  if (status != ERN_OK) return status;
  if (module->kind != ERN_PICKLE_TEXT || name->kind != ERN_PICKLE_TEXT) return damaged(m, "module or name is no text");
  status = ern_pickle_find_callable(m, module->as.words.text, name->as.words.text, &number);
  return status == ERN_OK ? push_integer(m, ERN_PICKLE_CALLABLE, number) : status;
}

static ern_status reduce(struct ern_pickle_machine *m) {
  struct ern_pickle_value *callable = NULL, *arguments = NULL, *made = NULL;
  ern_status status = pop(m, &arguments);
  if (status == ERN_OK) status = pop(m, &callable);
  if (status != ERN_OK) return status;
  if (callable->kind != ERN_PICKLE_CALLABLE || arguments->kind != ERN_PICKLE_TUPLE)
    return damaged(m, "expected a callable and a tuple");
  status = ern_pickle_call(m, (int)callable->as.integer, arguments, &made);
  return status == ERN_OK ? push(m, made) : status;
}

/* ---- collections ------------------------------------------------------------------------------------------------- */

static ern_status push_list(struct ern_pickle_machine *m, ern_pickle_kind kind, struct ern_pickle_value *const *item,
                            size_t count) {
  struct ern_pickle_value *list = NULL;
  ern_status status = ern_pickle_make(m, kind, &list);
  if (status != ERN_OK) return status;
  if (count > 0) {
    list->as.list.item = ern_pickle_allocate(m, count * sizeof *item, &status);
    if (status != ERN_OK) return status;
    memcpy(list->as.list.item, item, count * sizeof *item);
    list->as.list.count = list->as.list.capacity = count;
  }
  return push(m, list);
}

/* The tuple of the `count` topmost values. */
static ern_status push_tuple(struct ern_pickle_machine *m, size_t count) {
  struct ern_pickle_value *item[3] = {NULL};
  for (size_t i = count; i > 0; i--) {
    const ern_status status = pop(m, &item[i - 1]);
    if (status != ERN_OK) return status;
  }
  return push_list(m, ERN_PICKLE_TUPLE, item, count);
}

/* Moves values into the list or dict below them. */
static ern_status extend(struct ern_pickle_machine *m, bool dict, struct ern_pickle_value **item, size_t count) {
  struct ern_pickle_value *into = NULL;
  ern_status status = top(m, &into);
  if (status != ERN_OK) return status;
  if (dict ? !ern_pickle_is_dict(into) : into->kind != ERN_PICKLE_LIST)
    return damaged(m, dict ? "expected a dict below" : "expected a list below");
  if (dict && count % 2 != 0) return damaged(m, "a key without its value");
  for (size_t i = 0; i < count && status == ERN_OK; i++) status = ern_pickle_append(m, into, item[i]);
  return status;
}

static ern_status extend_top(struct ern_pickle_machine *m, bool dict, size_t count) {
  struct ern_pickle_value *item[2] = {NULL};
  for (size_t i = count; i > 0; i--) {
    const ern_status status = pop(m, &item[i - 1]);
    if (status != ERN_OK) return status;
  }
  return extend(m, dict, item, count);
}

static ern_status extend_marked(struct ern_pickle_machine *m, bool dict) {
  struct ern_pickle_value **item = NULL;
  size_t count = 0;
  const ern_status status = pop_mark(m, &item, &count);
  return status == ERN_OK ? extend(m, dict, item, count) : status;
}

static ern_status marked_list(struct ern_pickle_machine *m, ern_pickle_kind kind) {
  struct ern_pickle_value **item = NULL;
  size_t count = 0;
  ern_status status = pop_mark(m, &item, &count);
  if (status == ERN_OK && kind == ERN_PICKLE_DICT && count % 2 != 0) return damaged(m, "a key without its value");
  return status == ERN_OK ? push_list(m, kind, item, count) : status;
}

static ern_status build(struct ern_pickle_machine *m) {
  struct ern_pickle_value *state = NULL, *object = NULL;
  ern_status status = pop(m, &state);
  if (status == ERN_OK) status = top(m, &object);
  return status == ERN_OK ? ern_pickle_build(m, object, state) : status;
}

static ern_status persistent(struct ern_pickle_machine *m) {
  struct ern_pickle_value *id = NULL, *storage = NULL;
  ern_status status = pop(m, &id);
  if (status == ERN_OK) status = ern_pickle_storage(m, id, &storage);
  if (status == ERN_OK) status = grow(m, &m->storages, m->storages.count + 1);
  if (status != ERN_OK) return status;
  m->storages.item[m->storages.count++] = storage;
  return push(m, storage);
}

/* ---- the machine ------------------------------------------------------------------------------------------------- */

static ern_status number_then(struct ern_pickle_machine *m, size_t bytes,
                              ern_status (*use)(struct ern_pickle_machine *, size_t)) {
  uint64_t number = 0;
  const ern_status status = take_number(m, bytes, &number);
  return status == ERN_OK ? use(m, (size_t)number) : status;
}

static ern_status push_signed(struct ern_pickle_machine *m) {
  uint64_t number = 0;
  const ern_status status = take_number(m, 4, &number);
  return status == ERN_OK ? push_integer(m, ERN_PICKLE_INT, (int32_t)(uint32_t)number) : status;
}

static ern_status push_unsigned(struct ern_pickle_machine *m, size_t number) {
  return push_integer(m, ERN_PICKLE_INT, (int64_t)number);
}

static ern_status protocol(struct ern_pickle_machine *m, size_t version) {
  if (version >= 2 && version <= 5) return ERN_OK;
  return ern_fail(m->context, ERN_E_UNSUPPORTED, "%s: protocol %zu at offset %zu, expected 2 to 5", m->where, version,
                  m->begin);
}

/* The FRAME opcode only announces how many bytes follow. */
static ern_status frame(struct ern_pickle_machine *m) {
  uint64_t length = 0;
  const ern_status status = take_number(m, 8, &length);
  if (status == ERN_OK && length > m->count - m->at) return damaged(m, "a frame longer than the pickle");
  return status;
}

static ern_status step(struct ern_pickle_machine *m) {
  struct ern_pickle_value *dropped = NULL;
  switch (m->opcode) {
    case 0x80: return number_then(m, 1, protocol);
    case 0x95: return frame(m);
    case '(': return push(m, &m->mark);
    case 'N': return push_integer(m, ERN_PICKLE_NONE, 0);
    case 0x88: return push_integer(m, ERN_PICKLE_BOOL, 1);
    case 0x89: return push_integer(m, ERN_PICKLE_BOOL, 0);
    case 'J': return push_signed(m);
    case 'K': return number_then(m, 1, push_unsigned);
    case 'M': return number_then(m, 2, push_unsigned);
    case 0x8a: return number_then(m, 1, push_long);
    case 'G': return push_float(m);
    case 'X': return push_words(m, ERN_PICKLE_TEXT, 4);
    case 0x8c: return push_words(m, ERN_PICKLE_TEXT, 1);
    case 0x8d: return push_words(m, ERN_PICKLE_TEXT, 8);
    case 'U': return push_words(m, ERN_PICKLE_TEXT, 1); /* a text of Python 2 */
    case 'T': return push_words(m, ERN_PICKLE_TEXT, 4);
    case 'B': return push_words(m, ERN_PICKLE_BYTES, 4);
    case 'C': return push_words(m, ERN_PICKLE_BYTES, 1);
    case 0x8e: return push_words(m, ERN_PICKLE_BYTES, 8);
    case ')': return push_list(m, ERN_PICKLE_TUPLE, NULL, 0);
    case 0x85: return push_tuple(m, 1);
    case 0x86: return push_tuple(m, 2);
    case 0x87: return push_tuple(m, 3);
    case 't': return marked_list(m, ERN_PICKLE_TUPLE);
    case ']': return push_list(m, ERN_PICKLE_LIST, NULL, 0);
    case 'l': return marked_list(m, ERN_PICKLE_LIST);
    case '}': return push_list(m, ERN_PICKLE_DICT, NULL, 0);
    case 'd': return marked_list(m, ERN_PICKLE_DICT);
    case 'a': return extend_top(m, false, 1);
    case 'e': return extend_marked(m, false);
    case 's': return extend_top(m, true, 2);
    case 'u': return extend_marked(m, true);
    case 'q': return number_then(m, 1, memo_put);
    case 'r': return number_then(m, 4, memo_put);
    case 0x94: return memo_put(m, m->memo.count);
    case 'h': return number_then(m, 1, memo_get);
    case 'j': return number_then(m, 4, memo_get);
    case '0': return pop(m, &dropped);
    case 'c': return push_global(m);
    case 0x93: return push_stack_global(m);
    case 'R': return reduce(m);
    case 'b': return build(m);
    case 'Q': return persistent(m);
    default:
      return ern_fail(m->context, ERN_E_UNSUPPORTED,
                      "%s: opcode 0x%02x at offset %zu is not one that torch.save writes for tensors", m->where,
                      m->opcode, m->begin);
  }
}

static ern_status run(struct ern_pickle_machine *m, struct ern_pickle_value **root) {
  while (m->at < m->count) {
    m->begin = m->at;
    m->opcode = m->bytes[m->at++];
    if (m->begin == 0 && m->opcode != 0x80) return damaged(m, "expected 0x80, the protocol");
    if (m->opcode == '.') {
      const ern_status status = pop(m, root);
      if (status != ERN_OK) return status;
      if (m->stack.count != 0) return damaged(m, "values are left on the stack at the end");
      return m->first || m->at == m->count ? ERN_OK : damaged(m, "bytes follow the end");
    }
    const ern_status status = step(m);
    if (status != ERN_OK) return status;
  }
  return ern_fail(m->context, ERN_E_FORMAT, "%s: ends at %zu bytes without the opcode of its end", m->where, m->count);
}

void ern_pickle_free(ern_context *context, struct ern_pickle *pickle) {
  if (pickle == NULL) return;
  ern_pickle_arena_free(context, pickle->arena);
  ern_release(context, pickle->storage);
  *pickle = (struct ern_pickle){0};
}

static ern_status read_one(ern_context *context, const char *where, const uint8_t *bytes, size_t count, bool first,
                           struct ern_pickle *pickle, size_t *used) {
  struct ern_pickle_machine m = {.context = context,
                                 .where = where,
                                 .bytes = bytes,
                                 .count = count,
                                 .mark = {.kind = ERN_PICKLE_MARK},
                                 .first = first};
  ern_status status = ERN_OK;
  *pickle = (struct ern_pickle){0};
  ERN_TRY(ern_pickle_arena_make(context, &pickle->arena));
  m.arena = pickle->arena;
  status = run(&m, &pickle->root);
  *used = m.at;
fail:
  pickle->storage = m.storages.item;
  pickle->storages = m.storages.count;
  ern_release(context, m.stack.item);
  ern_release(context, m.memo.item);
  if (status != ERN_OK) ern_pickle_free(context, pickle);
  return status;
}

ern_status ern_pickle_read(ern_context *context, const char *where, const uint8_t *bytes, size_t count,
                           struct ern_pickle *pickle) {
  size_t used = 0;
  return read_one(context, where, bytes, count, false, pickle, &used);
}

ern_status ern_pickle_read_first(ern_context *context, const char *where, const uint8_t *bytes, size_t count,
                                 struct ern_pickle *pickle, size_t *used) {
  *used = 0;
  return read_one(context, where, bytes, count, true, pickle, used);
}
