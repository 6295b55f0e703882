# SPDX-License-Identifier: MIT
"""The module's copy of the C interface against the headers, by the C compiler: sizes, offsets and types of all members
of its structs, values of its enums, arguments and results of its functions. Needs ERNERF_SOURCE and ERNERF_LIBRARY; CC is the compiler."""
import ctypes
import enum
import os
import re
import subprocess
import tempfile
import unittest

from ernerf import _c

SOURCE = os.environ["ERNERF_SOURCE"]
_c.open_engine()  # which describes a struct
PREFIX = {"Status": "ERN_"}  # of an enum's values; of all others by the name of the enum
STRUCTS = [kind for kind in vars(_c).values() if isinstance(kind, type) and issubclass(kind, ctypes.Structure)
           and kind is not ctypes.Structure]
ENUMS = [kind for kind in vars(_c).values() if isinstance(kind, type) and issubclass(kind, enum.Enum)]
FUNCTIONS = {**_c.ENGINE, **_c.MEDIA}
TYPES = {ctypes.c_bool: "bool", ctypes.c_char: "char", ctypes.c_int: "int", ctypes.c_uint32: "uint32_t",
         ctypes.c_int64: "int64_t", ctypes.c_uint64: "uint64_t", ctypes.c_uint8: "uint8_t", ctypes.c_float: "float",
         ctypes.c_double: "double", ctypes.c_char_p: "const char *", ctypes.c_void_p: "void *", None: "void"}
INCLUDES = "".join(f"#include <{name}>\n" for name in (
    "ernerf/ernerf.h", "ernerf/media.h", "ernerf/speech.h", "stddef.h", "stdio.h"))


def snake(kind):
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def spelled(kind):
    """The C type of a type of ctypes; an array as the pointer that it becomes in an expression."""
    if kind in TYPES:
        return TYPES[kind]
    if kind in STRUCTS or kind in ENUMS:
        return f"ern_{snake(kind)}"
    if issubclass(kind, ctypes.Array):
        if issubclass(kind._type_, ctypes.Array):
            return f"{spelled(kind._type_._type_)} (*)[{kind._type_._length_}]"
        return f"{spelled(kind._type_)} *"
    if kind is _c.OUT:
        return "void *"  # stands for a pointer to any object's pointer
    if issubclass(kind, ctypes._Pointer):
        return f"{spelled(kind._type_)} *"
    arguments = (f"const {spelled(a)}" if issubclass(a, ctypes._Pointer) else spelled(a) for a in kind._argtypes_)
    return f"{spelled(kind._restype_)} (*)({', '.join(arguments)})"


def is_callback(kind):
    return isinstance(kind, type) and issubclass(kind, ctypes._CFuncPtr)


def headers():
    text = ""
    for name in ("base", "backend", "data", "model", "render", "setting", "train", "media", "speech"):
        with open(f"{SOURCE}/include/ernerf/{name}.h", encoding="utf-8") as file:
            text += file.read()
    return re.sub(r"/\*.*?\*/", "", text, flags=re.S)


HEADERS = headers()


def body(what, name):
    return re.search(rf"typedef {what} {name} \{{(.*?)\}} {name};", HEADERS, re.S).group(1)


def members(struct):
    """Names of a C struct's members in their order."""
    for declaration in body("struct", f"ern_{snake(struct)}").split(";")[:-1]:
        pointer = re.search(r"\(\*(\w+)\)", declaration)
        for name in [pointer.group(1)] if pointer else declaration.split(","):
            yield re.search(r"(\w+)\s*(\[[^]]*\]\s*)*$", name).group(1)


def compiled(text, *options):
    compiler = os.environ.get("CC", "cc")
    return subprocess.run([compiler, "-std=c17", "-I", f"{SOURCE}/include", "-x", "c", "-", *options], input=text,
                          text=True, capture_output=True)


class Headers(unittest.TestCase):
    def printed(self, statements):
        """What a C program says, by the words at the beginning of its lines."""
        with tempfile.TemporaryDirectory() as folder:
            program = f"{folder}/program"
            made = compiled(f"{INCLUDES}int main(void) {{\n{statements}}}\n", "-o", program)
            self.assertEqual(made.returncode, 0, made.stderr)
            lines = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
        return dict(line.split(" ", 1) for line in lines)

    def test_structs(self):
        self.assertGreaterEqual(len(STRUCTS), 20)
        text, expected = "", {}
        for struct in STRUCTS:
            c_name = f"ern_{snake(struct)}"
            self.assertEqual([name for name, _ in struct._fields_], list(members(struct)), c_name)
            text += f'printf("{c_name} %zu\\n", sizeof({c_name}));\n'
            expected[c_name] = str(ctypes.sizeof(struct))
            for name, kind in struct._fields_:
                member = f"(({c_name} *)0)->{name}"
                is_it = "1"
                if kind is not ctypes.c_void_p and not is_callback(kind):
                    kinds = {spelled(kind), f"const {spelled(kind).replace('const ', '')}"}
                    choices = ", ".join(f"{c_type}: 1" for c_type in kinds)
                    is_it = f"_Generic({member}, {choices}, default: 0)"
                text += (f'printf("{c_name}.{name} %zu %zu %d\\n", '
                         f'offsetof({c_name}, {name}), sizeof({member}), {is_it});\n')
                field = getattr(struct, name)
                expected[f"{c_name}.{name}"] = f"{field.offset} {field.size} 1"
        self.assertEqual(self.printed(text), expected)

    def test_enums(self):
        text, expected = "", {}
        for kind in ENUMS:
            prefix = PREFIX.get(kind.__name__, "ERN_" + snake(kind).replace("_level", "").upper() + "_")
            names = [prefix + value.name for value in kind]
            self.assertEqual(names, re.findall(r"\bERN_\w+", body("enum", f"ern_{snake(kind)}")), kind)
            for value in kind:
                text += f'printf("{prefix}{value.name} %d\\n", (int){prefix}{value.name});\n'
                expected[prefix + value.name] = str(int(value))
        self.assertEqual(self.printed(text), expected)

    def call(self, function, result, arguments):
        """Body and arguments of a C function that calls `function` with arguments of the module's types."""
        takes = ", ".join(spelled(a).replace("(*)", f"(*a{n})") if is_callback(a) else f"{spelled(a)} a{n}"
                          for n, a in enumerate(arguments))
        values = ", ".join(f"a{n}" for n in range(len(arguments)))
        called = f"{function}({values})"
        if result is not None and issubclass(result, ctypes._Pointer):
            called = f"const {spelled(result)} result = {called}; (void)result"
        elif result is not None:
            called = f"{spelled(result)} result = {called}; (void)result"
        return f"{{ {called}; }}", takes

    def test_functions(self):
        calls = {name: (name, result, arguments) for name, (result, *arguments) in FUNCTIONS.items()}
        for struct in STRUCTS:
            for name, kind in struct._fields_:
                if is_callback(kind):
                    c_name = f"ern_{snake(struct)}"
                    calls[f"{c_name}_{name}"] = f"(({c_name} *)0)->{name}", kind._restype_, kind._argtypes_
        text = INCLUDES + "".join(
            f"void check_{name}({takes or 'void'}); void check_{name}({takes or 'void'}) {does}\n"
            for name, (does, takes) in ((name, self.call(*call)) for name, call in calls.items()))
        warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wsign-conversion", "-Wdouble-promotion", "-Werror",
                    "-fsyntax-only"]
        made = compiled(text, *warnings)
        self.assertEqual(made.returncode, 0, made.stderr)
        for right, wrong in (("float a2", "size_t a2"), ("ern_image * a3", "ern_camera * a3"), ("int64_t a2", "float a2")):
            self.assertIn(right, text)
            self.assertNotEqual(compiled(text.replace(right, wrong, 1), *warnings).returncode, 0, wrong)  # it does look


if __name__ == "__main__":
    unittest.main()
