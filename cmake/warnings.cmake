# Every target of this project is built with the same warnings; ERNERF_WERROR makes them errors (CI).
function(ern_warnings target)
  target_compile_options(
    ${target} PRIVATE -Wall -Wextra -Wconversion -Wshadow -Wvla $<$<COMPILE_LANGUAGE:C>:-Wstrict-prototypes>
                      $<$<BOOL:${ERNERF_WERROR}>:-Werror>)
  target_compile_definitions(${target} PRIVATE _POSIX_C_SOURCE=200809L)
endfunction()
