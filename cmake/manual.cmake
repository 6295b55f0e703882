# Manual pages and shell completions, which the program itself prints, and the page of the file formats, made from
# docs/formats.md and the two documents beside it. Left out when cross compiling without an emulator.
if(CMAKE_CROSSCOMPILING AND NOT CMAKE_CROSSCOMPILING_EMULATOR)
  return()
endif()
set(manual ${PROJECT_BINARY_DIR}/manual)
set(pages "")
function(ern_print file) # ... words after `ernerf help`
  add_custom_command(OUTPUT ${manual}/${file} COMMAND ernerf-cli help ${ARGN} > ${manual}/${file} DEPENDS ernerf-cli)
  set(pages ${pages} ${manual}/${file} PARENT_SCOPE)
endfunction()
file(MAKE_DIRECTORY ${manual}/man1 ${manual}/man5)
ern_print(man1/ernerf.1 --man)
file(GLOB verbs CONFIGURE_DEPENDS RELATIVE ${PROJECT_SOURCE_DIR}/tools/ernerf-cli ${PROJECT_SOURCE_DIR}/tools/ernerf-cli/*/cmd_*.c)
foreach(verb IN LISTS verbs)
  string(REGEX REPLACE ".*cmd_([a-z]+)[.]c$" "\\1" verb ${verb})
  ern_print(man1/ernerf-${verb}.1 --man ${verb})
endforeach()
ern_print(ernerf.bash --bash)
ern_print(_ernerf --zsh)

find_program(LOWDOWN lowdown)
if(LOWDOWN)
  set(formats formats.md formats-training.md formats-results.md)
  set(page ${manual}/man5/ernerf-formats.5)
  list(TRANSFORM formats PREPEND ${PROJECT_SOURCE_DIR}/docs/ OUTPUT_VARIABLE sources)
  add_custom_command(
    OUTPUT ${page}
    COMMAND ${CMAKE_COMMAND} -DLOWDOWN=${LOWDOWN} "-DSOURCES=${sources}" -DOUTPUT=${page}
            -DVERSION=${PROJECT_VERSION} -P ${CMAKE_CURRENT_LIST_DIR}/formats_page.cmake
    DEPENDS ${sources} ${CMAKE_CURRENT_LIST_DIR}/formats_page.cmake
    VERBATIM)
  list(APPEND pages ${page})
else()
  message(STATUS "lowdown is missing: no page ernerf-formats(5) in the manual")
endif()
add_custom_target(manual ALL DEPENDS ${pages})

install(DIRECTORY ${manual}/man1 ${manual}/man5 DESTINATION ${CMAKE_INSTALL_MANDIR} FILES_MATCHING PATTERN "*.[15]")
install(FILES ${manual}/ernerf.bash DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions RENAME ernerf)
install(FILES ${manual}/_ernerf DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/site-functions)
