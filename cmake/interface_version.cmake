# core/interface_version.h: ERN_INTERFACE_VERSION, the version with a hash of all headers. Libraries of one version that were
# built from different headers refuse each other (docs/abi.md).
file(GLOB_RECURSE headers RELATIVE ${PROJECT_SOURCE_DIR} CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/include/*.h ${PROJECT_SOURCE_DIR}/src/*.h)
set(hashes "")
foreach(header IN LISTS headers)
  file(SHA256 ${PROJECT_SOURCE_DIR}/${header} hash)
  string(APPEND hashes "${header} ${hash}\n")
endforeach()
set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${headers})
string(SHA256 hash "${hashes}")
string(SUBSTRING ${hash} 0 12 hash)
set(ERNERF_INTERFACE_VERSION ${PROJECT_VERSION}_${hash})
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/src/core/interface_version.h CONTENT "/* of the version and of all headers */
#define ERN_INTERFACE_VERSION \"${ERNERF_INTERFACE_VERSION}\"
")
include_directories(${PROJECT_BINARY_DIR}/src)
