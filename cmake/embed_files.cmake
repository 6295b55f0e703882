# Writes files as C arrays ARRAY_NAME[], with a 0 after the last byte, and their lengths LENGTH_NAME:
# cmake -DNAMES="a;b" -DFOLDER=... -DENDING=.cl -DARRAY=ern_cl_text -DLENGTH=ern_cl_bytes -DOUTPUT=... -P embed_files.cmake
set(text "#include <stddef.h>\n")
foreach(name IN LISTS NAMES)
  file(READ ${FOLDER}/${name}${ENDING} bytes HEX)
  string(LENGTH "${bytes}" length)
  math(EXPR length "${length} / 2")
  string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${bytes}")
  string(APPEND text "extern const unsigned char ${ARRAY}_${name}[];\nextern const size_t ${LENGTH}_${name};\n")
  string(APPEND text "const unsigned char ${ARRAY}_${name}[] = {${bytes}0};\n")
  string(APPEND text "const size_t ${LENGTH}_${name} = ${length};\n")
endforeach()
file(WRITE ${OUTPUT} "${text}")
